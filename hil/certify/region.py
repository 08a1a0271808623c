"""Regions of stability: a loop that is linear only while its commands stay within limits, as under saturation.

The linear loop is mean-square stable. While no command leaves its limits the run is that of the linear loop, which goes to rest,
or ends within the bound of the departures. `design.jump_linear.leaving` bounds the probability that a command ever leaves.

The state is moved at the start of the run, at every step of the reference and at every disturbance. If that probability is at
most `RISK` for all of these together, the run is certified; else the verdict is undecided and states the region.

Where a command beyond its limit acts as the limit, `hil.certify.saturation` knows more.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from design.controllers import GainTable, controller_traits
from design.errors import DesignError
from design.verdict import Verdict
from hil.certify import CertificationProblem
from hil.certify.motion_test import SEED
from hil.plugins import is_ours
from hil.rig.loop import Array
from plants.parts.protocols import HasOwnInputs, HasSensorNoise

RISK = 0.01
"""Largest probability of leaving at which a run is certified."""
RISKS = (RISK, 0.1)
"""Probabilities whose regions are stated."""


NO_COMMAND = 1e-9
"""Share of a limit up to which a steady command is rounding."""


class ClosedLoop(NamedTuple):
    """The closed loop of a plant, with the plant's state first.

    Attributes:
        matrices: (N, size, size).
        chances: (N, N) transition probabilities, or upper bounds of them.
        inputs: (N, m, size) with u(k) = U_i x(k).
        standing: (size, n), the state of the loop where the plant has long stood at x.
    """

    matrices: Array
    chances: Array
    inputs: Array
    standing: Array


def judge_region(
    loop: CertificationProblem, verdict: Verdict, closed: ClosedLoop, *, limits: Array, pushes: Array, adds: Array, clips: bool,
    named: str,
) -> Verdict:
    """Extend the verdict on a loop that stays within its limits to the loop that may leave them.

    Args:
        loop: the loop.
        verdict: on the loop whose commands stay within the limits; certified.
        closed: that loop.
        limits: largest command, (m,); inf where there is none.
        pushes: (N, size, q), what signals of size 1 push it by in a slot.
        adds: largest sum that departures add to each command directly, (m,).
        clips: whether a disturbance that would take the input beyond a limit acts only in part.
        named: the departures, as phrases.
    """
    from design.jump_linear.leaving import leaving

    unknown = not_judged(loop)
    if unknown:
        return _outside(verdict, named, f"not decided {unknown} ({verdict.reason})", {})
    try:
        starts, steady, why = _begins(loop, limits)
        which = np.flatnonzero(np.isfinite(limits))
        room = limits[which] - steady[which]
        if (room <= adds[which]).any():
            return _outside(verdict, named, "not decided: the reference or the departures alone take the whole command", {})
        fresh = np.eye(*closed.standing.shape)  # at the first slot no sample is under way, at a step of the reference all are
        found = leaving(
            closed.matrices, closed.chances, closed.inputs[:, which], np.stack([closed.standing, fresh]),
            limits=room, pushes=pushes[:, :, pushes.any(axis=(0, 1))], adds=adds[which],
            later=max((slots[-1] for slots, _ in starts), default=0),
        )  # fmt: skip
    except (DesignError, np.linalg.LinAlgError) as error:
        return _outside(verdict, named, f"not decided: {error}", {})
    names = [(str(s.name), str(s.unit)) for s in loop.plant.states]
    regions = []
    for risk in RISKS:
        degree, radii = found.radii(risk)
        regions.append({"probability": risk, "states": {name: float(r) for (name, _), r in zip(names, radii)}, "degree": degree})
    left = 1.0 if clips else 1.0 - float((largest_disturbance(loop)[which] / room).max())  # it may act before a limit
    if starts and left <= 0.0:
        starts, why = [], "a disturbance takes the whole command"
    own = found.probability(*starts, left=left) if starts else None
    lasts = "for ever" if found.slots is None else f"for {found.slots} slots"
    details = {"region": {
        "of": [name for name, _ in names], "within": regions, "slots": found.slots, "own_probability": own,
        "limits_times": found.needed(RISK),
        "pushed_share": [float(min(b[i] for b in found.pushed)) for i in range(len(which))],
    }}  # fmt: skip
    radii = np.array(list(regions[0]["states"].values()))  # type: ignore[attr-defined]
    if not radii.any():
        share = 100.0 * max(float(min(b[i] for b in found.pushed)) for i in range(len(which)))
        return _outside(verdict, named, (
            f"not decided: what departs may take {share:.3g} % of the command, in the root mean square: no "
            f"start keeps it within its limits {lasts} with probability {1.0 - RISK:g}, for which they must be "
            f"{found.needed(RISK):.3g} times as large"
        ), details)  # fmt: skip
    place = ", ".join(f"|{name}| < {r:.4g} {unit}" for (name, unit), r in zip(names, radii))
    together = " (one alone, or shares of them that add up to 1)" if len(names) > 1 else ""
    region = (
        f"from inside {place}{together} no command leaves its limits {lasts} with probability {1.0 - RISK:g}; "
        f"{verdict.reason}"
    )
    if own is None or own > RISK:
        why = why or f"leaving it has a probability of up to {own:.3g}"
        return _outside(verdict, named, f"not decided from where this run begins ({why}); {region}", details)
    counted = "" if found.slots is None else f" in the first {found.slots} slots"
    return replace(
        verdict, kind="stability in a region", number=own, limit=RISK,
        quantity=f"bound of the probability of leaving the region{counted}",
        reason=f"this run begins inside, leaving it{counted} has a probability of at most {own:.3g}: {region}",
        details={**verdict.details, **details},
        assumptions=(*verdict.assumptions, "start, reference and disturbances are the experiment's"),
        method=f"{verdict.method}; even moments of the command, Markov's inequality",
    )  # fmt: skip


def _outside(verdict: Verdict, named: str, reason: str, details: Mapping[str, object]) -> Verdict:
    return replace(
        verdict, kind="stability in a region" if details else "mean-square stability", state="undecided",
        reason=f"certified while commands stay within their limits ({named}); {reason}",
        details={**verdict.details, **details, "stable": False},
    )  # fmt: skip


def not_judged(loop: CertificationProblem) -> str:
    """Return an influence on a loop that has no known bound, a phrase; empty: there is none."""
    plant = loop.plant
    if isinstance(plant, HasOwnInputs) and plant.own_inputs():
        return f"with {', '.join(plant.own_inputs())}"
    if isinstance(plant, HasSensorNoise) and np.any(plant.sensor_noise()):
        return "with noise on what is measured"
    return "" if is_ours(loop.controller) else "with a controller of your own, which may add to its rows"


def _first_rows(loop: CertificationProblem) -> str:
    """Return why the first rows of a run, before any sample or packet, are not those of the loop; empty: they are the same."""
    controller, its = loop.controller, controller_traits(loop.controller)
    if its.samples > 1:
        return "its first packets repeat their sample"
    if its.row_sojourns > 1 or (its.sojourns if isinstance(its.sojourns, int) else max(its.sojourns, default=1)) > 1:
        return "its stays are counted from its first packet on"
    nodes = loop.model.nodes
    together = not (nodes.turns or nodes.mixed or nodes.silent) and None not in nodes.delays and len(set(nodes.delays)) == 1
    if len(nodes.names) > 1 and not together:
        return "its rows are zeros until a packet of every node has come"
    rule = controller.selection if isinstance(controller, GainTable) else "constant"
    same = rule in ("constant", "applied") or (rule in ("generated", "both") and loop.model.d_max <= 1)
    return "" if same else "its first rows are picked before any delay is known"


def _first_slots(loop: CertificationProblem) -> float:
    """Slots until a packet has come in both directions; inf where that has no bound."""
    chains = [chain for chain in (loop.sc, loop.ca) if chain is not None and not chain.holds.any()]
    return 1.0 + sum(chain.max_delay for chain in chains) if len(chains) == 2 else np.inf


def largest_disturbance(loop: CertificationProblem) -> Array:
    """Return the largest disturbance of each input in a slot, (m,)."""
    values = np.array([w for _, w in loop.disturbance]).reshape(-1, loop.motion.B.shape[1])
    return np.asarray(np.abs(values).max(axis=0, initial=0.0))


def first_state(loop: CertificationProblem) -> Array | None:
    """Return the state in slot 0, (n,); None where it is drawn, or is not that of the model."""
    one, two = (np.array(loop.plant.start(np.random.default_rng(seed)).state) for seed in (SEED, SEED + 1))
    return one if len(one) == len(loop.motion.A) and np.array_equal(one, two) else None


def _begins(loop: CertificationProblem, limits: Array) -> tuple[list[tuple[Sequence[int], Array]], Array, str]:
    """Return slots in which the state is moved, with the shift in each; the largest steady command, (m,); and a reason.

    No slots, with the reason, where the start of the experiment is not judged.
    """
    from design.controllers.gain_rows import SteadyState, held_exactly, steady_state
    from design.jump_linear.leaving import SLOTS

    A, B, C = loop.motion.A, loop.motion.B, loop.motion.C
    (n, m), p, first = B.shape, len(C), first_state(loop)
    slots, references = [slot for slot, _ in sorted(loop.steps)], np.array([r for _, r in sorted(loop.steps)]).reshape(-1, p)
    star = steady_state(A, B, C) if references.any() else SteadyState(np.zeros((n, p)), np.zeros((m, p)))
    if not held_exactly(A, B, C, references):
        return [], np.zeros(m), "no input holds its reference"
    points, steady = [np.zeros(n), *(references @ star.state.T)], np.abs(references @ star.input.T).max(axis=0, initial=0.0)
    pushes = [(range(slot + 1, end + 1), w) for (slot, w), (end, _) in pairwise(loop.disturbance) if any(w)]
    if first is None:
        return [], steady, "its first state is not known"
    if (steady > NO_COMMAND * np.where(np.isfinite(limits), limits, 1.0)).any():
        return [], steady, "its reference needs a steady command"
    if max(*slots, *(pushed[-1] for pushed, _ in pushes), 0, 0) >= SLOTS:
        return [], steady, f"its reference steps, or a disturbance comes, after slot {SLOTS}"
    jumps = [first - points[0], *(before - after for before, after in pairwise(points))]
    begun: dict[int, Array] = {}
    for slot, jump in zip([0, *slots], jumps):
        begun[slot] = begun.get(slot, np.zeros(n)) + jump
    starts: list[tuple[Sequence[int], Array]] = [((slot,), shift) for slot, shift in begun.items()]
    starts += [(pushed, column) for pushed, w in pushes for column in (B * w).T]  # of each a share of its own may act
    unlike = _first_rows(loop)
    if unlike and any(slots[0] <= _first_slots(loop) and shift.any() for slots, shift in starts):
        return [], steady, unlike
    return starts, steady, ""
