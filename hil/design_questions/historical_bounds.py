"""How far gains over historical data are from the best that any controller could do, and what another order would cost."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from msgspec.structs import replace

from design.controllers import HistoryGains, SensorNodes
from design.controllers.sensor_nodes import Uses
from hil.certify.historical_loop import delayed_plant_of, known_past
from hil.errors import HilError
from hil.rig.loop import Loop

if TYPE_CHECKING:
    from design.historical_data import DelayedPlant
    from design.historical_data.gapped_history import PhaseGains
    from design.historical_data.guaranteed_cost import Start

Gains = npt.NDArray[np.float64]


def judge_historical(loop: Loop, *, orders: bool = False, spread: bool = False) -> dict[str, Any]:
    """Return what gains cost, what no controller can go below, and the gains; the cost is the plant's own.

    The means are over x(0) ~ N(0, I) with a zero history; slot 0 is any turn of a cycle, and drawn where turns are. The bound of
    a causal controller is known where the schedule is a cycle or a chain that no state or input changes: not with triggers,
    clocks that draw, or delays that change.

    Args:
        loop: an experiment with gains over historical data.
        orders: whether every cyclic order of the nodes is tried, each with gains of its own of least mean cost.
        spread: whether the standard deviation of `cost` over the runs is computed, too, as `cost_sd`.

    Raises:
        HilError: another controller or plant, or orders that cannot be tried.
    """
    from design.historical_data import close
    from design.historical_data.cost_bounds import causal_bound, cost_moments, hearing_of, mean_full_state_bound
    from design.historical_data.gapped_history import phase_gains

    controller, nodes, name = loop.controller, loop.model.nodes, loop.experiment.name
    plant = delayed_plant_of(loop.experiment.plant, loop.model)
    if not isinstance(controller, HistoryGains) or plant is None:
        raise HilError(
            f"{name}: hil design judges gains over historical data of a plant that measures its state; "
            "hil run solves other gains over several sensor nodes, with kind = 'designed'"
        )
    if loop.verdict is None or not loop.verdict.certified:
        raise HilError(f"{name}: {'no verdict' if loop.verdict is None else loop.verdict.reason}")
    K = controller.history()
    found: dict[str, Any] = {
        "experiment": name, "uses": controller.uses, "cost": loop.verdict.details["cost"], "mean_cost": None,
        "bound_full_state": None, "bound_causal": None, "gap": None, "verdict": loop.verdict.to_json(), "gains": K.tolist(),
    }  # fmt: skip
    start, each = _any_start(nodes, controller.uses, K)
    closed = close(plant, each.gains, each.transition, renewed=each.renewed)
    found["mean_cost"] = start.mean(closed.stable_cost_to_go())
    found["bound_full_state"] = mean_full_state_bound(plant, start.moment)
    hearing = hearing_of(nodes)
    if hearing is not None:
        found["bound_causal"] = causal_bound(plant, hearing, start.moment)
        found["gap"] = found["mean_cost"] / found["bound_causal"] - 1.0
    if spread:
        if each.renewed is not None:
            raise HilError(f"{name}: --spread: not over a history with lost packets: its {len(each.gains)} phases are too many")
        found["cost_sd"] = 0.0
        if each.transition is not None:
            phases = phase_gains(K, nodes, controller.uses).start  # of the run: the schedule's first phase
            found["cost_sd"] = float(np.sqrt(cost_moments(closed, known_past(loop.experiment.plant), phases).variance))
    if orders:
        found["orders"] = _orders(plant, nodes, K, name)
    return found


def _any_start(nodes: SensorNodes, uses: Uses, K: Gains) -> tuple[Start, PhaseGains]:
    """Return a start from x(0) ~ N(0, I) in any turn, and the gains of all phases."""
    from design.historical_data.gapped_history import phase_gains
    from design.historical_data.guaranteed_cost import Start

    turns = nodes.turns
    begins = [turns]
    if turns is not None and turns.cycle:
        begins = [replace(turns, phase=phase) for phase in range(turns.phases)]
    each = [phase_gains(K, replace(nodes, turns=begin), uses) for begin in begins]
    return Start(moment=np.eye(K.shape[-1]), phases=np.mean([one.start for one in each], axis=0)), each[0]


def _orders(plant: DelayedPlant, nodes: SensorNodes, K: Gains, name: str) -> list[dict[str, Any]]:
    from design.historical_data.guaranteed_cost import average_start
    from design.historical_data.least_cost import orders_by_cost

    turns = nodes.turns
    alike = len(set(nodes.buffers)) == len(set(nodes.delays)) == 1 and None not in nodes.delays and not nodes.silent
    if not alike or turns is None or turns.loss or sorted(turns.order) != list(range(len(nodes.names))):
        raise HilError(f"{name}: --orders: needs turns in a fixed order, one for every node, no loss, and one buffer and delay")
    memory = max(K.shape[1] - 1, nodes.buffers[0] - 1 + (nodes.delays[0] or 0))
    tried = orders_by_cost(plant, nodes, average_start(len(plant.A), len(turns.order)), memory)
    return [{"nodes": [nodes.names[n] for n in each.order], "mean_cost": each.cost} for each in tried]
