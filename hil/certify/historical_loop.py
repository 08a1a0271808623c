"""The certifier of Chapter 5: gains over what scheduled sensor nodes have sent, over a plant whose state they measure.

How far such gains are from the best that any controller could do, and what another order of the nodes would cost.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from design.controllers import HistoryGains, LoopModel, SensorNodes
from design.controllers.sensor_nodes import window_of
from design.verdict import Kind, Verdict
from hil.certify import CertificationProblem, limited_to_model, undecided, why_no_history
from hil.errors import HilError
from hil.rig.loop import Array, Loop
from plants.parts.protocols import BeyondModel, HasCost, HasSensorNoise, HasStateDelays, HasStateHistory, JumpPlant, Plant

if TYPE_CHECKING:
    from design.historical_data import DelayedPlant
    from design.historical_data.sensor_schedule import PhaseGains
    from design.processes.delay_chain import DelayChain


KIND: Kind = "guaranteed cost"
MOST_NUMBERS = 700_000
"""In the matrices of all phases; a certificate of these takes some seconds."""
MOST_SPREAD = 64
"""Phases over which the variance of the cost is computed: it takes the fourth power of the order for each."""


def delayed_plant_of(plant: Plant, model: LoopModel, ca: DelayChain | None = None) -> DelayedPlant | None:
    """Return a plant as Chapter 5 takes it; None for one that jumps, or does not measure its state.

    A plant that states no cost is weighed by the unit matrix, its input by zero. Commands that are all as old when they act, by
    the chain of their ages, are delayed in the plant.
    """
    from design.historical_data import DelayedPlant

    n, m = model.B.shape
    if isinstance(plant, JumpPlant) or not np.array_equal(model.C, np.eye(n)):
        return None
    delayed = plant.state_delays() if isinstance(plant, HasStateDelays) else np.zeros((0, n, n))
    weight, input_weight = plant.cost_weights() if isinstance(plant, HasCost) else (np.eye(n), np.zeros((m, m)))
    late = 0 if ca is None or ca.delay.min() < ca.max_delay else ca.max_delay
    return DelayedPlant(A=model.A, delayed=delayed, B=model.B, weight=weight, input_weight=input_weight, input_delay=late)


def mask_faults(controller: HistoryGains, nodes: SensorNodes) -> list[str]:
    """Return the gains on samples that have not arrived when they would be used, each with its place; empty: none.

    Reference: thesis (5.8).
    """
    from design.historical_data.sensor_schedule import mask_of, window_mask

    if None in nodes.delays:
        return []
    K = controller.history()
    try:
        if controller.uses == "last-packets" and nodes.turns is not None:
            mask = window_mask(nodes, window_of(nodes.turns, len(K)), K.shape[1] - 1)
        else:
            mask = mask_of(nodes, K.shape[1] - 1, controller.uses)
    except ValueError as error:
        return [str(error)]
    owner = {output: name for name, own in zip(nodes.names, nodes.outputs) for output in own}
    wrong = np.argwhere((K != 0.0) & ~mask[:, :, None, :])
    faults = [
        f"controller.gains[{i}][{j}][{row}][{l}]: {K[i, j, row, l]:g}, expected 0: in this phase the sample of {j} slots ago "
        f"from node {owner[l]!r} has not arrived"
        for i, j, row, l in wrong[:20].tolist()
    ]
    return faults + ([f"controller.gains: {len(wrong) - 20} more entries of this kind"] if len(wrong) > 20 else [])


def certify_historical(loop: CertificationProblem) -> Verdict | None:
    """Return the verdict on gains over historical data: stable or not, exactly, and what the loop costs; None for other loops.

    The cost in the details is that of the run: from the plant's first state, in the schedule's first phase. `bound_full_state`
    beside it is what no controller goes below from there, over any network.
    """
    controller, nodes = loop.controller, loop.model.nodes
    if not isinstance(controller, HistoryGains):
        return None
    from design.historical_data.guaranteed_cost import Start, certify_cost

    plant = delayed_plant_of(loop.plant, loop.motion)
    if plant is None:
        return undecided(loop, KIND, why_no_history(loop.plant, loop.motion))
    history = known_past(loop.plant)
    x0 = history[0]
    if x0.shape != (len(plant.A),):
        said = f"[plant] has {len(x0)} states, and its model {len(plant.A)}: what it costs from its first state is not known"
        return undecided(loop, KIND, said)
    least = _least_cost(loop.plant, plant, history)
    each = loop.history
    if each is None or isinstance(each, str):
        return undecided(loop, KIND, each or loop.no_chain(), least)
    plant, each = with_commands(plant, each)
    order = len(plant.A) * (max(each.gains.shape[1] - 1, plant.memory) + 2)
    if (numbers := len(each.gains) * order**2) > MOST_NUMBERS:
        said = f"what is known has {len(each.gains)} phases of {order} states: {numbers} numbers, at most {MOST_NUMBERS}"
        return undecided(loop, KIND, said, least)
    noise = loop.plant.sensor_noise() if isinstance(loop.plant, HasSensorNoise) else None
    start = Start(moment=np.outer(x0, x0), phases=each.start)
    verdict = certify_cost(
        plant, each.gains, start, each.transition, history=history, deviation=noise, renewed=each.renewed, ages=each.ages,
    )  # fmt: skip
    lossy = nodes.turns is not None and nodes.turns.loss
    lost = "packets are lost on the medium as it states, and nowhere else" if lossy else "no packet is lost"
    calm = ["the cost is without disturbances"] * bool(loop.disturbance)
    known = msgspec.structs.replace(
        verdict, digest=loop.digest, details={**verdict.details, **least},
        assumptions=(*verdict.assumptions, *calm, lost, "no limit trips"),
    )  # fmt: skip
    return limited_to_model(loop.plant, known, knows_state_delays=True)


def with_commands(plant: DelayedPlant, each: PhaseGains) -> tuple[DelayedPlant, PhaseGains]:
    """Return the plant with its commands late by as many slots as they are in all phases, where it is one number."""
    if each.ages is None or (ages := set(each.ages.tolist())) == {-1} or len(ages) > 1:
        return plant, each
    return replace(plant, input_delay=ages.pop()), msgspec.structs.replace(each, ages=None)


def known_past(plant: Plant) -> Array:
    """Return x(0), x(-1), ... as the plant starts, (h, n); what lies before is zero."""
    x0 = np.array(plant.start(np.random.default_rng(0)).state)
    return np.vstack([x0, plant.state_history()]) if isinstance(plant, HasStateHistory) else x0[None]


def _least_cost(plant: Plant, delayed: DelayedPlant, history: Array) -> dict[str, float]:
    """Return what no controller goes below, whatever else is unknown; nothing where the plant is more than its model."""
    from design.errors import Infeasible
    from design.historical_data.cost_bounds import full_state_bound

    if isinstance(plant, BeyondModel) and plant.beyond_model():
        return {}
    try:
        return {"bound_full_state": full_state_bound(delayed, history)}
    except Infeasible:
        return {}  # no controller stabilises it


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
    from design.historical_data.cost_bounds import arrivals_of, causal_bound, cost_moments, mean_full_state_bound
    from design.historical_data.guaranteed_cost import Start, run_from

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
    plant, each = with_commands(plant, _phases(loop, controller, in_phase=False))
    start = Start(moment=np.eye(len(plant.A)), phases=each.start)
    closed = close(plant, each.gains, each.transition, renewed=each.renewed, ages=each.ages)
    arrivals = None if each.ages is not None else arrivals_of(nodes)
    mean = start.mean(closed.stable_cost_to_go())
    bound = None if arrivals is None else causal_bound(plant, arrivals, start.moment)
    found: dict[str, Any] = {
        "experiment": name, "uses": controller.uses, "cost": loop.verdict.details["cost"], "mean_cost": mean,
        "bound_full_state": mean_full_state_bound(replace(plant, input_delay=0), start.moment), "bound_causal": bound,
        "gap": None if bound is None else mean / bound - 1.0, "verdict": loop.verdict.to_json(), "gains": K.tolist(),
    }  # fmt: skip
    if spread:
        if each.renewed is not None or len(each.gains) > MOST_SPREAD:
            raise HilError(f"{name}: --spread: not over a history with gaps: its {len(each.gains)} phases are too many")
        found["cost_sd"] = 0.0
        if each.transition is not None:
            phases = _phases(loop, controller, in_phase=True).start  # of the run: the schedule's first phase
            history = known_past(loop.experiment.plant)
            if history[1:].any():  # which no sensor has seen
                closed, history = run_from(plant, each.gains, history, each.transition, ages=each.ages)
            found["cost_sd"] = float(np.sqrt(cost_moments(closed, history, phases).variance))
    if orders:
        found["orders"] = _orders(plant, nodes, K, name)
    return found


def _phases(loop: Loop, controller: HistoryGains, *, in_phase: bool) -> PhaseGains:
    """Return the gains of all phases, from the run's own slot 0 on or from any slot of the cycle.

    Raises:
        HilError: they are not known.
    """
    from hil.rig.loop_chains import history_of

    found = history_of(loop.rig, loop.chains, controller, loop.model, in_phase=in_phase)
    if isinstance(found, str):
        raise HilError(f"{loop.experiment.name}: {found}")
    return found


def _orders(plant: DelayedPlant, nodes: SensorNodes, K: Array, name: str) -> list[dict[str, Any]]:
    from design.historical_data.guaranteed_cost import average_start
    from design.historical_data.least_cost import orders_by_cost

    turns = nodes.turns
    alike = len(set(nodes.buffers)) == len(set(nodes.delays)) == 1 and None not in nodes.delays and not nodes.silent
    if not alike or turns is None or turns.loss or sorted(turns.order) != list(range(len(nodes.names))):
        raise HilError(f"{name}: --orders: needs turns in a fixed order, one for every node, no loss, and one buffer and delay")
    memory = max(K.shape[1] - 1, nodes.buffers[0] - 1 + (nodes.delays[0] or 0))
    tried = orders_by_cost(plant, nodes, average_start(len(plant.A), len(turns.order)), memory)
    return [{"nodes": [nodes.names[n] for n in each.order], "mean_cost": each.cost} for each in tried]
