"""A loop whose plant, sensors or triggers depart from the linear one by bounded amounts: it ends within a bound.

The linear loop is mean-square stable, and what departs from it is a signal that pushes it, whatever that depends on. Then the
root mean square of every output ends within a bound that the loop's own second moments give.

A relative trigger lets every sample be wrong by a share of itself: one quadratic family over all shares decides.
"""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from design.controllers import GainTable, LoopModel, controller_traits
from design.errors import DesignError, NotStable
from design.jump_linear import STABILITY_MARGIN
from design.verdict import Verdict
from hil.certify import CertificationProblem, Check, limited_to_model, table_of
from hil.certify.motion_test import SLOTS, drive, random_inputs
from hil.rig.loop import Array
from plants.parts.protocols import BeyondModel, HasDepartures, HasOwnInputs, MovesOtherwise, Plant

if TYPE_CHECKING:
    from collections.abc import Callable

    from hil.certify.region import ClosedLoop

    Modes = Callable[[Array, Array, Array], ClosedLoop]
    """Makes the closed loop of a plant (A, B, C)."""

PARTS = 16
"""Parts of a slot over which the motion of an input that changes within the slot is bounded."""
ROUNDING, LARGEST = 1e-9, 1e12
CLAMPED = "a clamped integral"


class Pushed(Struct, frozen=True, kw_only=True):
    """What pushes a loop from within.

    Args:
        names: noun phrases.
        states: what signals of size 1 move the state by in a slot, together, (n, q).
        outputs: what it adds to each output at most, (p,).
        within: largest command up to which these bounds hold, (m,); inf where they hold at any.
        clips: whether a command beyond that acts as the largest, a disturbance that would take the input beyond it by a share.
    """

    names: tuple[str, ...]
    states: Array
    outputs: Array
    within: Array
    clips: bool

    @property
    def pushes(self) -> bool:
        """Whether anything is moved at all, while the commands are within their limits."""
        return bool(self.states.any() or self.outputs.any())


def clamped_share(loop: CertificationProblem) -> Array:
    """Return what the clamped sums of errors add to each input at most, (m,), in any row that the actuator may apply.

    Zeros beside a state of the controller's own, which they move, too: there the sums are taken for outputs.
    """
    share, p, its = np.zeros(loop.motion.B.shape[1]), len(loop.motion.C), controller_traits(loop.controller)
    limit = np.array(its.integral_limit)
    if limit.size and isinstance(loop.controller, GainTable) and not its.order:
        share = (np.abs(table_of(loop, loop.controller)[..., -p:]) @ limit).max(axis=(0, 1))
    return share


def pushed_by(loop: CertificationProblem, share: Array, *, clamped: bool = False) -> Pushed | None:
    """Return what pushes a loop from within; None where nothing does, or where something beyond the model has no bound.

    Args:
        loop: the loop.
        share: what clamped sums of errors add to each input at most, (m,), see `clamped_share`; zeros: of the plant alone.
        clamped: whether they count.
    """
    plant, model = loop.plant, loop.motion
    beyond = set(plant.beyond_model()) if isinstance(plant, BeyondModel) else set()
    known = tuple(plant.departures()) if isinstance(plant, HasDepartures) else ()
    if beyond - {each.name for each in known} or len(plant.states) != len(model.A) or not (known or loop.slack or clamped):
        return None
    inputs, outputs = share.copy(), np.zeros(len(model.C))
    within = np.full(len(inputs), np.inf)
    for each in known:
        (inputs if each.at == "input" else outputs)[:] += each.bounds
        within = np.minimum(within, each.within or np.inf)
    clips = all(each.clips for each in known if each.within)
    names = (*(each.name for each in known), *(["a dead-band trigger"] * bool(loop.slack)), *([CLAMPED] * clamped))
    return Pushed(names=names, states=_moved(plant, model, inputs), outputs=outputs + _slack(loop), within=within, clips=clips)


def _slack(loop: CertificationProblem) -> Array:
    return np.array(loop.slack) if loop.slack else np.zeros(len(loop.model.C))


def _moved(plant: Plant, model: LoopModel, inputs: Array) -> Array:
    r"""What inputs up to a size F, at any instants of a slot, move the state by: a column by signals of size 1, (n, q).

    One signal for every part of a slot, of length h, moves it by the mean over the part; what is left of a part is at most h / 2
    times what the response varies by there.

    .. math:: \int_0^T e^{A s} B F e(s) ds = \sum_k \int_{kh}^{(k+1)h} e^{A s} B F ds \; \bar e_k + r, \qquad
        |r| \le \tfrac{h}{2} \int_0^T |e^{A s} A B| F ds \le \tfrac{h^2}{2} e^{|A| h} \sum_k |e^{A k h} A B| F
    """
    if not inputs.any():
        return np.zeros((len(model.A), 0))
    from scipy.linalg import expm

    from plants.parts import StateSpace

    moves = plant.motion() if isinstance(plant, MovesOtherwise) else plant.model()
    if not isinstance(moves, StateSpace):  # in slots an input changes with the slot
        return np.asarray(model.B * inputs)
    h, (n, m) = model.period_s / PARTS, moves.B.shape
    held = expm(np.block([[moves.A, moves.B], [np.zeros((m, n + m))]]) * h)
    step, part, slope, columns, left = held[:n, :n], held[:n, n:], moves.A @ moves.B, [], np.zeros((n, m))
    for _ in range(PARTS):
        columns.append(part * inputs)
        left += np.abs(slope)
        part, slope = step @ part, step @ slope
    rest = 0.5 * h**2 * expm(np.abs(moves.A) * h) @ left @ inputs
    return np.hstack([*columns, np.diag(rest)])


def ends_within(loop: CertificationProblem, verdict: Verdict, modes: Modes) -> Verdict:
    """Return a verdict on the linear loop as one on the loop that is pushed: where its outputs end, or undecided.

    Args:
        loop: the loop.
        verdict: on the linear loop; where a sum of errors is clamped, on the loop without it.
        modes: makes the closed loop of a plant, without a clamped sum too.
    """
    share, its = clamped_share(loop), controller_traits(loop.controller)
    clamped = bool(its.integral_limit)
    if loop.shares and clamped:
        return _undecided(verdict, f"{CLAMPED} beside a relative trigger")
    if loop.shares:
        beside = "a dead-band trigger beside a relative one"
        found = _undecided(verdict, beside) if loop.slack else _by_share(loop, verdict, modes)
        return limited_to_model(loop.plant, found, knows_state_delays=True)
    pushed = pushed_by(loop, share, clamped=clamped)
    limited = pushed is not None and bool(np.isfinite(pushed.within).any())
    if pushed is not None and not limited and verdict.state == "refused" and not _by_bounds(loop):
        return _grows_from_afar(verdict, pushed)
    if pushed is not None and limited and pushed.clips and verdict.state == "refused":
        from hil.certify.saturation import runs_away

        if (lost := runs_away(loop, verdict, limits=pushed.within, named=", ".join(pushed.names))) is not None:
            return lost
    if clamped and (pushed is None or not verdict.certified):
        return _undecided(verdict, CLAMPED)
    if pushed is None or not verdict.certified:
        if loop.slack:
            return _undecided(verdict, "a dead-band trigger")
        return limited_to_model(loop.plant, verdict, knows_state_delays=True)
    if limited and len(loop.stacked.A) > len(loop.motion.A):
        return _undecided(verdict, f"{', '.join(pushed.names)} beside delayed states")
    from design.jump_linear.leaving import ultimate_bound

    A, B, C = loop.stacked.A, loop.stacked.B, loop.stacked.C
    n, m = B.shape
    sums = np.array(its.integral_limit if its.order else ())
    p, measured = len(C) + len(sums), np.vstack([C, np.zeros((len(sums), n))])
    # The plant with what is added to its outputs as states that last no slot, and clamped sums as outputs that it does not make.
    # A sum is that of the slot, whatever the age of the sample beside it: no register holds it for a later slot.
    closed, chances, applied, standing = modes(
        np.block([[A, np.zeros((n, p))], [np.zeros((p, n + p))]]), np.vstack([B, np.zeros((p, m))]),
        np.hstack([measured, np.eye(p)]),
    )  # fmt: skip
    held, outputs = standing[:, n + len(C) : n + p], slice(n, n + len(C))
    kept, q = np.array([i for i in range(closed.shape[-1]) if not n <= i < n + p and not held[i].any()]), pushed.states.shape[1]
    own, E = closed[:, kept][:, :, kept], np.zeros((len(closed), len(kept), q + p))
    E[:, : len(pushed.states), :q], E[:, :, q : q + len(C)] = pushed.states, closed[:, kept][:, :, outputs] * pushed.outputs
    E[:, :, q + len(C) :] = (closed @ held)[:, kept] * sums
    ends = {}
    try:
        for row, signal in zip(C, loop.plant.outputs):
            z = np.zeros((1, len(kept)))
            z[0, :n] = row
            ends[str(signal.name)] = (float(ultimate_bound(own, chances, E, z).sum()), str(signal.unit))
    except (NotStable, np.linalg.LinAlgError) as error:
        return _undecided(verdict, f"{', '.join(pushed.names)}: {error}")
    said = ", ".join(f"{name} within {bound:.4g} {unit}" for name, (bound, unit) in ends.items())
    ending = f"ends, in the root mean square, with {said}" if pushed.pushes or sums.any() else "goes to rest"
    found = replace(
        verdict, kind="practical stability",
        reason=f"with {', '.join(pushed.names)} it {ending}; without, {verdict.reason}",
        details={**verdict.details, "ends_within": {name: bound for name, (bound, _) in ends.items()}},
        assumptions=(*verdict.assumptions, "the bound is of the motion around the reference, without loads and noise"),
        method=f"{verdict.method}; what departs from it is bounded, and pushes it",
    )
    if not limited:
        return found
    from hil.certify.region import ClosedLoop, judge_region
    from hil.certify.saturation import ends_from_anywhere, escapes

    adds = (np.abs(applied[:, :, outputs]) @ pushed.outputs + np.abs(applied @ held) @ sums).max(axis=0) + share
    within = ClosedLoop(own, chances, applied[:, :, kept], standing[kept, :n])
    named = ", ".join(pushed.names)
    by_plant = pushed_by(loop, np.zeros(m)) if pushed.clips else None  # what a clamped integral adds is within the limit too
    inside = replace(found, reason=f"while no command passes its limit {verdict.reason}")
    lost = None if by_plant is None else escapes(loop, inside, limits=pushed.within, pushes=by_plant.states, named=named)
    if lost is not None:
        return lost
    region = judge_region(loop, found, within, limits=pushed.within, pushes=E, adds=adds, clips=pushed.clips, named=named)
    if region.certified or not pushed.clips:
        return region
    return ends_from_anywhere(loop, region, within, limits=pushed.within, pushes=pushed.states, adds=pushed.outputs)


def _by_bounds(loop: CertificationProblem) -> bool:
    """Whether probabilities of a chain are known by bounds alone."""
    return any(chain is not None and chain.between is not None for chain in (loop.sc, loop.ca))


def _grows_from_afar(verdict: Verdict, pushed: Pushed) -> Verdict:
    r"""Return the refusal of a linear loop as one of the loop that is pushed, by a bounded amount whatever its state is.

    A family Q with E(A_i' Q_j A_i) = rho Q_i, rho > 1, is there (Krein and Rutman). In its seminorm |x|^2 = E x' Q x

    .. math:: |x(k+1)| \ge \sqrt{\rho}\, |x(k)| - c, \qquad |e(k)| \le c,

    so that from |x(0)| > c / (sqrt(rho) - 1) on it grows for ever.
    """
    named = ", ".join(pushed.names)
    return replace(
        verdict, kind="practical stability",
        reason=f"with {named} it grows from far enough, for that pushes it by a bounded amount alone; without, {verdict.reason}",
        method=f"{verdict.method}; what departs from it is bounded",
    )  # fmt: skip


def _by_share(loop: CertificationProblem, verdict: Verdict, modes: Modes) -> Verdict:
    """Return a verdict on the linear loop as one on samples that are wrong by a share, another in every slot and output."""
    what = "a relative trigger"
    if not verdict.certified:
        return _undecided(verdict, what)
    from design.networked_loop.polytope import MOST_UNKNOWNS, family_growth

    A, B, C = loop.stacked.A, loop.stacked.B, loop.stacked.C
    wrong = [l for l, share in enumerate(loop.shares) if share]
    signs = np.ones((2 ** len(wrong), len(C)))
    signs[:, wrong] += np.array(list(product((-1.0, 1.0), repeat=len(wrong)))) * np.array(loop.shares)[wrong]
    nominal, chances = modes(A, B, C)[:2]
    corners = np.array([modes(A, B, sign[:, None] * C).matrices for sign in signs])
    try:
        growth = family_growth(nominal, chances, corners, corners)
    except (DesignError, np.linalg.LinAlgError) as error:
        return _undecided(verdict, f"{what}: {error}")
    if growth is None:
        return _undecided(verdict, f"{what}: a quadratic family has more than {MOST_UNKNOWNS} unknowns here")
    if growth.factor >= 1.0 - STABILITY_MARGIN:
        return _undecided(verdict, f"{what}: no quadratic family was found that falls (the best: {growth.factor:.4g})")
    largest = 100.0 * max(loop.shares)
    return replace(
        verdict, number=growth.factor, quantity="largest factor by which one quadratic family grows in a slot",
        reason=f"the loop is mean-square stable with samples wrong by up to {largest:.3g} %, another share in every slot: "
        f"one quadratic family per mode grows by at most {growth.factor:.5g} in a slot; without, {verdict.reason}",
        details={**verdict.details, "growth_of_one_family": growth.factor},
        assumptions=(*verdict.assumptions, "around 0: a reference r adds to a sample up to its share of r, which stays bounded"),
        method="one quadratic family per mode over the shares (semidefinite program)",
    )  # fmt: skip


def _undecided(verdict: Verdict, what: str) -> Verdict:
    return replace(
        verdict, state="undecided", reason=f"{verdict.state} without {what}; not decided with it ({verdict.reason})",
        details={**verdict.details, "stable": False},
    )  # fmt: skip


def departure_check(loop: CertificationProblem) -> Check:
    """Return whether a plant departs from its motion by no more than it says, step by step under random inputs."""
    plant, model, pushed = loop.plant, loop.motion, pushed_by(loop, np.zeros(loop.motion.B.shape[1]))
    if pushed is None:
        return "undecided", "what the plant says of its departures changes from call to call"
    if isinstance(plant, HasOwnInputs) and plant.own_inputs():
        return None, ("the plant departs from its model by no more than it says: not compared, as it is moved from within too",)
    m = model.B.shape[1]
    unit = np.minimum(np.ones(m) if loop.input_limits is None else np.array(loop.input_limits, dtype=float), pushed.within)
    steps, furthest = 0, np.abs(pushed.states).sum(axis=1)
    disturbed = 3.0 if pushed.clips and np.isfinite(pushed.within).all() else 0.0
    most_input = pushed.within if pushed.clips else np.full(m, np.inf)
    shape = random_inputs(SLOTS, m) * unit
    for size, beside in ((1e-3, 0.0), (0.03, 0.0), (1.0, 0.0), (1.0, disturbed), *([(30.0, 0.0)] if disturbed else ())):
        u = shape * size
        w = beside * u[::-1]
        track = drive(plant, round(model.period_s * 1e9), u, disturbances=w)
        large = ~(np.abs(track.states[1:]).max(axis=1) <= LARGEST)
        count = int(large.argmax()) if large.any() else len(large)
        x, after, y, u, w = track.states[:count], track.states[1 : count + 1], track.outputs[1 : count + 1], u[:count], w[:count]
        sizes = np.abs(x).max(axis=1) + np.abs(after).max(axis=1) + (np.abs(u) @ np.abs(model.B).T).max(axis=1)
        lost = ROUNDING * (sizes[:, None] + 1e-300)
        half = 0.5 * model.B * w[:, None, :]  # of a disturbance any share may act: as much as half of it beside half of it
        taken = np.clip(u, -most_input, most_input) @ model.B.T
        compared = (
            ("states", after - x @ model.A.T - taken - half.sum(axis=2), furthest + np.abs(half).sum(axis=2)),
            ("outputs", y - after @ model.C.T, np.broadcast_to(pushed.outputs - _slack(loop), y.shape)),
        )
        first = [(int(far.argmax()), what, found, most) for what, found, most in compared
                 if (far := (np.abs(found) > most + lost).any(axis=1)).any()]  # fmt: skip
        if first:
            k, what, found, most = min(first, key=lambda each: each[0])
            at = int((np.abs(found[k]) - most[k]).argmax())
            asked = size * (1.0 + beside) * float(unit.max())
            return "refused", (
                f"your plant departs further than stated: inputs up to {asked:.3g} move its {what} by "
                f"{abs(found[k, at]):.4g} beyond its model in a slot, and departures() says at most {float(most[k, at]):.4g}"
            )
        steps += count
    return None, (f"the plant departs from its model by no more than it says: compared in {steps} slots",)
