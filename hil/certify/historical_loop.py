"""The certifier of Chapter 5: gains over what scheduled sensor nodes have sent, over a plant whose state they measure."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import msgspec
import numpy as np
from numpy.typing import NDArray

from design.controllers import HistoryGains, LoopModel, SensorNodes
from design.controllers.sensor_nodes import window_of
from design.verdict import Kind, Verdict
from hil.certify import CertificationProblem, limited_to_model, undecided, why_no_history
from plants.parts.protocols import BeyondModel, HasCost, HasSensorNoise, HasStateDelays, HasStateHistory, JumpPlant, Plant

if TYPE_CHECKING:
    from design.historical_data import DelayedPlant

KIND: Kind = "guaranteed cost"


def delayed_plant_of(plant: Plant, model: LoopModel) -> DelayedPlant | None:
    """Return a plant as Chapter 5 takes it; None for one that jumps, or does not measure its state.

    A plant that states no cost is weighed by the unit matrix, its input by zero.
    """
    from design.historical_data import DelayedPlant

    n, m = model.B.shape
    if isinstance(plant, JumpPlant) or not np.array_equal(model.C, np.eye(n)):
        return None
    delayed = plant.state_delays() if isinstance(plant, HasStateDelays) else np.zeros((0, n, n))
    weight, input_weight = plant.cost_weights() if isinstance(plant, HasCost) else (np.eye(n), np.zeros((m, m)))
    return DelayedPlant(A=model.A, delayed=delayed, B=model.B, weight=weight, input_weight=input_weight)


def mask_faults(controller: HistoryGains, nodes: SensorNodes) -> list[str]:
    """Return the gains on samples that have not arrived when they would be used, each with its place; empty: none.

    Reference: thesis (5.8).
    """
    from design.historical_data.gapped_history import window_mask
    from design.historical_data.sensor_schedule import mask_of

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
    from design.historical_data.gapped_history import gains_undecided, phase_gains
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
    K = loop.once("history", lambda: np.array(controller.history(), dtype=float))
    unknown = gains_undecided(K, nodes, controller.uses, plant.memory)
    if nodes.silent:
        unknown = f"the theory does not know when the triggers or clocks of the nodes {', '.join(nodes.silent)} let them send"
    if unknown:
        return undecided(loop, KIND, unknown, least)
    if loop.ca is None:
        return undecided(loop, KIND, loop.no_chain(), least)
    late = sorted(set(loop.ca.delay.tolist()))
    if len(late) > 1:
        said = f"network.ca: commands are {', '.join(map(str, late))} slots old when they act; gains over historical data are " \
            'judged where each is as old as the last (law = { kind = "constant", age = ... })'
        return undecided(loop, KIND, said, least)
    plant = replace(plant, input_delay=loop.ca.max_delay)
    each = phase_gains(K, nodes, controller.uses)
    noise = loop.plant.sensor_noise() if isinstance(loop.plant, HasSensorNoise) else None
    start = Start(moment=np.outer(x0, x0), phases=each.start)
    verdict = certify_cost(plant, each.gains, start, each.transition, history=history, deviation=noise, renewed=each.renewed)
    lossy = nodes.turns is not None and nodes.turns.loss
    lost = "packets are lost on the medium as it states, and nowhere else" if lossy else "no packet is lost"
    known = msgspec.structs.replace(
        verdict, digest=loop.digest, details={**verdict.details, **least},
        assumptions=(*verdict.assumptions, lost, "no limit trips"),
    )
    return limited_to_model(loop.plant, known, knows_state_delays=True)


def known_past(plant: Plant) -> NDArray[np.float64]:
    """Return x(0), x(-1), ... as the plant starts, (h, n); what lies before is zero."""
    x0 = np.array(plant.start(np.random.default_rng(0)).state)
    return np.vstack([x0, plant.state_history()]) if isinstance(plant, HasStateHistory) else x0[None]


def _least_cost(plant: Plant, delayed: DelayedPlant, history: NDArray[np.float64]) -> dict[str, float]:
    """Return what no controller goes below, whatever else is unknown; nothing where the plant is more than its model."""
    from design.errors import Infeasible
    from design.historical_data.cost_bounds import full_state_bound

    if isinstance(plant, BeyondModel) and plant.beyond_model():
        return {}
    try:
        return {"bound_full_state": full_state_bound(delayed, history)}
    except Infeasible:
        return {}  # no controller stabilises it
