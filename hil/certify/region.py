"""Regions of stability: a loop that is linear only while its commands stay within limits, as under saturation.

The linear loop is mean-square stable. While no command leaves its limits the run is that of the linear loop, which goes to rest,
or ends within the bound of the departures. `design.jump_linear.leaving` bounds the probability that a command ever leaves.

The state is moved at the start of the run, at every step of the reference and at every disturbance. If that probability is at
most `RISK` for all of these together, the run is certified; else the verdict is undecided and states the region.

Two further results hold where a command beyond its limit acts as the limit: a loop around an integrator ends within a bound from
any state (`ends_from_anywhere`), and a run that begins where no command holds an unstable mode is refused (`escapes`).
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise, product
from typing import Any, NamedTuple

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from design.controllers import (
    GainTable,
    integral_limit,
    integrates,
    packet_samples,
    row_sojourns_distinguished,
    sojourns_distinguished,
)
from design.errors import DesignError
from design.verdict import Verdict
from hil.certify.certifier import CertificationProblem, table_of
from hil.certify.motion_test import SEED
from hil.plugins.user_modules import is_ours
from plants.parts.protocols import HasOwnInputs, HasSensorNoise

Array = NDArray[np.float64]
RISK = 0.01
"""Largest probability of leaving at which a run is certified."""
RISKS = (RISK, 0.1)
"""Probabilities whose regions are stated."""
ROUNDING = 1e-6


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


def inside(
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
        starts, steady, why = _begins(loop)
        which = np.flatnonzero(np.isfinite(limits))
        room = limits[which] - steady[which]
        if (room <= adds[which]).any():
            return _outside(verdict, named, "not decided: the reference or the departures alone take the whole command", {})
        fresh = np.eye(*closed.standing.shape)  # at the first slot no sample is under way, at a step of the reference all are
        found = leaving(
            closed.matrices, closed.chances, closed.inputs[:, which], np.stack([closed.standing, fresh]),
            limits=room, pushes=pushes[:, :, pushes.any(axis=(0, 1))], adds=adds[which],
            later=max((slot for slot, _ in starts), default=0),
        )  # fmt: skip
    except (DesignError, np.linalg.LinAlgError) as error:
        return _outside(verdict, named, f"not decided: {error}", {})
    names = [(str(s.name), str(s.unit)) for s in loop.plant.states]
    regions = []
    for risk in RISKS:
        degree, radii = found.radii(risk)
        regions.append({
            "probability": risk, "states": {name: float(r) for (name, _), r in zip(names, radii)}, "degree": degree,
        })  # fmt: skip
    taken = (float((np.abs(np.array(w))[which] / room).max()) for _, _, w in loop.pulses)  # it may act before a limit
    left = 1.0 if clips else 1.0 - max(taken, default=0.0)
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
    controller = loop.controller
    if packet_samples(controller) > 1:
        return "its first packets repeat their sample"
    sojourns = sojourns_distinguished(controller)
    if row_sojourns_distinguished(controller) > 1 or (sojourns if isinstance(sojourns, int) else max(sojourns, default=1)) > 1:
        return "its stays are counted from its first packet on"
    nodes = loop.model.nodes
    together = not (nodes.turns or nodes.mixed or nodes.silent) and None not in nodes.delays and len(set(nodes.delays)) == 1
    if len(nodes.names) > 1 and not together:
        return "its rows are zeros until every node was heard"
    rule = controller.selection if isinstance(controller, GainTable) else "constant"
    same = rule in ("constant", "applied") or (rule in ("generated", "both") and loop.model.d_max <= 1)
    return "" if same else "its first rows are picked before any delay is known"


def _first_slots(loop: CertificationProblem) -> float:
    """Slots until a packet has come in both directions; inf where that has no bound."""
    chains = [chain for chain in (loop.sc, loop.ca) if chain is not None and not chain.holds.any()]
    return 1.0 + sum(chain.max_delay for chain in chains) if len(chains) == 2 else np.inf


def _first_state(loop: CertificationProblem) -> Array | None:
    """The state in slot 0, (n,); None where it is drawn, or is not that of the model."""
    one, two = (np.array(loop.plant.start(np.random.default_rng(seed)).state) for seed in (SEED, SEED + 1))
    return one if len(one) == len(loop.motion.A) and np.array_equal(one, two) else None


def _begins(loop: CertificationProblem) -> tuple[list[tuple[int, Array]], Array, str]:
    """Return the slots in which the state is moved, each with its shift; the largest steady command, (m,); and a reason.

    No slots, with the reason, where the start of the experiment is not judged.
    """
    from design.jump_linear.leaving import SLOTS
    from design.networked_loop.loop_parts import check_held, steady_state

    A, B, C = loop.motion.A, loop.motion.B, loop.motion.C
    m, first = B.shape[1], _first_state(loop)
    references = [np.array(value) for _, value in sorted(loop.steps)]
    points, steady = [np.zeros(len(A))], np.zeros(m)
    if any(r.any() for r in references):
        star = steady_state(A, B, C)
        for r in references:
            check_held(A, B, C, star, r[None])
            points.append(star.state @ r)
            steady = np.maximum(steady, np.abs(star.input @ r))
    else:
        points += [np.zeros(len(A))] * len(references)
    pushes = [(slot + i + 1, B @ np.array(w)) for slot, length, w in loop.pulses for i in range(length)]
    if first is None:
        return [], steady, "its first state is not known"
    if steady.max(initial=0.0) > 1e-9:
        return [], steady, "its reference needs a steady command"
    if max(*(slot for slot, _ in loop.steps), *(slot for slot, _ in pushes), 0, 0) >= SLOTS:
        return [], steady, f"its reference steps, or a disturbance comes, after slot {SLOTS}"
    unlike = _first_rows(loop)
    if unlike and ((first - points[0]).any() or any(slot <= _first_slots(loop) for slot, _ in pushes)):
        return [], steady, unlike
    slots = [0, *(slot for slot, _ in sorted(loop.steps))]
    jumps = [first - points[0], *(before - after for before, after in pairwise(points))]
    begun: dict[int, Array] = {}
    for slot, jump in zip(slots, jumps):
        begun[slot] = begun.get(slot, np.zeros(len(A))) + jump
    return [*begun.items(), *pushes], steady, ""  # pushes on their own: of a disturbance a share may act


def escapes(loop: CertificationProblem, verdict: Verdict, *, limits: Array, pushes: Array, named: str) -> Verdict | None:
    r"""Return the refusal of a run that begins where no command within its limits brings it back; None where none is known.

    A left eigenvector of the plant, l A = lambda l with |lambda| > 1, grows whatever the controller answers: f is the most that
    commands within their limits, disturbances and departures move l x by in a slot. Noise of mean 0 leaves it true of E l x.

    .. math:: |l x(k+1)| \ge |\lambda| |l x(k)| - f, \qquad |l x(0)| > f / (|\lambda| - 1) \Rightarrow |l x(k)| \to \infty

    Args:
        loop: the loop; beyond a limit its plant acts as at the limit.
        verdict: on the loop within its limits.
        limits: largest command, (m,); inf where there is none.
        pushes: (n, q), what signals of size 1 move the plant's state by in a slot.
        named: what departs, as phrases.
    """
    plant, A, B, first = loop.plant, loop.motion.A, loop.motion.B, _first_state(loop)
    if first is None or (isinstance(plant, HasOwnInputs) and plant.own_inputs()):
        return None
    disturbed = np.max([np.abs(w) for _, _, w in loop.pulses], axis=0, initial=0.0) if loop.pulses else np.zeros(B.shape[1])
    rates, left = np.linalg.eig(A.T)
    for rate, mode in sorted(zip(np.abs(rates), left.T), key=lambda each: -each[0]):
        moved = np.abs(mode @ B)
        if rate <= 1.0 + ROUNDING or np.isinf(limits[moved > 0.0]).any():
            continue
        most = float(moved @ (np.where(moved > 0.0, limits, 0.0) + disturbed) + np.abs(mode @ pushes).sum())
        begins = float(abs(mode @ first)) * (rate - 1.0)
        if begins > (1.0 + ROUNDING) * most > 0.0:
            return replace(
                verdict, kind="stability in a region", state="refused", number=begins / most, limit=1.0,
                quantity="growth of an unstable mode in the first slot over the most that moves it back",
                reason=f"no controller brings this run back: a mode of the plant that grows by {100.0 * (rate - 1.0):.3g} % in a "
                f"slot begins at {begins / most:.4g} times what the largest command can hold ({named}); {verdict.reason}",
                details={**verdict.details, "stable": False, "unstable_mode_begins_at": begins / most},
                assumptions=(*verdict.assumptions, "start and disturbances are the experiment's"),
                method=f"left eigenvector of the open plant; {verdict.method}",
            )  # fmt: skip
    return None


def ends_from_anywhere(
    loop: CertificationProblem, verdict: Verdict, closed: ClosedLoop, *, limits: Array, pushes: Array, adds: Array
) -> Verdict:
    """Extend an undecided verdict by the bound within which the loop ends from any state; unchanged where none is known.

    Args:
        loop: the loop; beyond a limit its plant acts as at the limit.
        verdict: undecided, on the loop within its limits.
        closed: that loop.
        limits: largest command, (m,).
        pushes: (n, q), what signals of size 1 move the plant's state by in a slot, the share of a clamped integral among them.
        adds: what departures add to each output, at most, (p,).
    """
    controller, m, p = loop.controller, loop.motion.B.shape[1], len(loop.motion.C)
    if not isinstance(controller, GainTable) or packet_samples(controller) > 1 or (m, p) != (1, 1):
        return verdict
    if integrates(controller) and not integral_limit(controller):
        return verdict
    if loop.sc is None or loop.ca is None or loop.neglects or not_judged(loop):
        return verdict
    if loop.sc.holds.any() or loop.ca.holds.any():  # what is held has no largest age
        return verdict
    from design.networked_loop.saturated_integrator import ends_in_every_order, ends_in_mean, integrator

    A, B, C = loop.motion.A, loop.motion.B, loop.motion.C
    delay = int(loop.sc.delay.max() + loop.ca.delay.max())
    known: Any = {"limit": float(limits[0]), "delay": delay, "pushes": pushes, "adds": float(adds[0])}
    try:
        try:
            ends, surely = ends_in_every_order(A, B, C, gains=table_of(loop, controller)[..., :p], **known), True
        except DesignError:
            if loop.sc.open or loop.ca.open:
                return verdict
            gains, chances = _acting(closed, integrator(A, C)[1], int(loop.ca.delay.max()))
            ends, surely = ends_in_mean(A, B, C, gains=gains, chances=chances, **known), False
    except (DesignError, np.linalg.LinAlgError):
        return verdict
    signal = loop.plant.outputs[0]
    order = f"in every order of delays up to {delay} slots" if surely else "in the root mean square"
    return replace(
        verdict, kind="practical stability", state="certified", number=ends.share, limit=1.0,
        quantity="what departs from the model as a share of what the limited command moves",
        reason=f"from anywhere it {'surely ' if surely else ''}ends with {signal.name} within {ends.output:.4g} {signal.unit} of "
        f"its reference, {order}, however long commands saturate; {verdict.reason}",
        details={
            **verdict.details, "stable": True, "ends_surely_within" if surely else "ends_from_anywhere_within":
            {str(s.name): float(bound) for s, bound in zip(loop.plant.states, ends.states)},
        },
        assumptions=(*verdict.assumptions, "the last step of the reference, and the last disturbance, are over"),
        method=f"{'sign of the delayed sample' if surely else 'drift'} around a saturated integrator; {verdict.method}",
    )  # fmt: skip


def _acting(closed: ClosedLoop, v: Array, delay: int) -> tuple[Array, Array]:
    """The gain that acts after each path of modes, for a plant that has long stood at v, (n,); and the order of these gains."""
    from design.networked_loop.saturated_integrator import MOST_STATES

    modes = range(len(closed.matrices))
    if len(modes) ** (delay + 1) > MOST_STATES:
        raise DesignError("too many paths of modes say which gain acts")
    paths, gains = list(product(modes, repeat=delay + 1)), []
    for path in paths:
        state = closed.standing @ v
        for mode in path[:-1]:
            state = closed.matrices[mode] @ state
            state[: len(v)] = v
        gains.append(float(closed.inputs[path[-1], 0] @ state))
    follows = [[closed.chances[a[-1], b[-1]] if a[1:] == b[:-1] else 0.0 for b in paths] for a in paths]
    return np.array(gains), np.array(follows)
