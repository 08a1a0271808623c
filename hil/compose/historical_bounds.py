"""How far gains over historical data are from the best that any controller could do, and what another order would cost."""

from __future__ import annotations

from collections import Counter
from typing import Any

from design.controllers import HistoryGains, SensorNodes
from hil.compose.historical_loop import delayed_plant_of
from hil.compose.loop import Loop
from hil.errors import HilError


def judge_historical(loop: Loop, *, orders: bool = False) -> dict[str, Any]:
    """Return what gains cost, what no controller can go below, and the gains; the cost is the plant's own.

    The means are over x(0) ~ N(0, I) with a zero history in any phase. Means and bounds are known where turns follow a fixed
    order, no packet is lost, and all nodes have one buffer and one delay; else they are None.

    Args:
        loop: an experiment with gains over historical data.
        orders: whether every cyclic order of the nodes is tried, each with gains of its own of least mean cost.

    Raises:
        HilError: another controller or plant, or orders that cannot be tried.
    """
    from design.historical_data.guaranteed_cost import average_start, cost, lower_bounds
    from design.historical_data.lifted_loop import close
    from design.historical_data.orders import orders_by_cost

    controller, nodes, name = loop.controller, loop.model.nodes, loop.experiment.name
    plant = delayed_plant_of(loop.experiment.plant, loop.model)
    if not isinstance(controller, HistoryGains) or plant is None:
        raise HilError(f"{name}: several sensor nodes; hil design judges gains over historical data, of a plant that measures "
                       "its state; hil run solves others by kind = 'designed'")  # fmt: skip
    if loop.verdict is None or not loop.verdict.certified:
        raise HilError(f"{name}: {'no verdict' if loop.verdict is None else loop.verdict.reason}")
    K = controller.history()
    found: dict[str, Any] = {
        "experiment": name, "uses": controller.uses, "cost": loop.verdict.details["cost"], "mean_cost": None,
        "bound_full_state": None, "bound_causal": None, "gap": None, "verdict": loop.verdict.to_json(), "gains": K.tolist(),
    }  # fmt: skip
    if controller.uses == "last-packets" or not _fixed_order(nodes):
        if orders:
            raise HilError(f"{name}: --orders: needs turns in a fixed order, no loss, and one buffer and delay for all nodes")
        return found
    from design.historical_data.information import Information

    turns, start = nodes.turns, average_start(len(plant.A), len(K))
    owner = {output: n for n, own in enumerate(nodes.outputs) for output in own}
    info = Information(
        nodes=tuple(owner[i] for i in range(len(plant.A))), order=turns.order if turns else (), buffer=nodes.buffers[0],
        memory=max(K.shape[1] - 1, nodes.buffers[0] - 1 + (nodes.delays[0] or 0)), delay=nodes.delays[0] or 0,
    )  # fmt: skip
    bounds = lower_bounds(plant, info, start)
    mean = cost(close(plant, K), start)
    found |= {"mean_cost": mean, "bound_full_state": bounds.full_state, "bound_causal": bounds.causal}
    found["gap"] = mean / bounds.causal - 1.0
    if orders:
        if Counter(info.order) != Counter(range(len(nodes.names))):
            raise HilError(f"{name}: --orders: every node needs one turn in a cycle")
        found["orders"] = [
            {"nodes": [nodes.names[n] for n in each.order], "mean_cost": each.cost} for each in orders_by_cost(plant, info, start)
        ]
    return found


def _fixed_order(nodes: SensorNodes) -> bool:
    turns = nodes.turns
    alike = len(set(nodes.buffers)) == len(set(nodes.delays)) == 1 and None not in nodes.delays
    return turns is not None and bool(turns.order) and not turns.loss and alike and not nodes.silent
