"""Loops whose commands saturate: where they end from any state, and from where no command brings a run back."""

from __future__ import annotations

from itertools import product

import numpy as np
from msgspec.structs import replace

from design.controllers import GainTable, controller_traits
from design.errors import DesignError
from design.verdict import Verdict
from hil.certify import CertificationProblem, table_of
from hil.certify.region import ClosedLoop, first_state, largest_disturbance, not_judged
from hil.rig.loop import Array
from plants.parts.protocols import HasOwnInputs

ROUNDING = 1e-6


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
    plant, A, B, first = loop.plant, loop.motion.A, loop.motion.B, first_state(loop)
    if first is None or (isinstance(plant, HasOwnInputs) and plant.own_inputs()):
        return None
    disturbed, (rates, left) = largest_disturbance(loop), np.linalg.eig(A.T)
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


def runs_away(loop: CertificationProblem, verdict: Verdict, *, limits: Array, named: str) -> Verdict | None:
    """Return the refusal of a loop that grows within its limits, where from far enough no command holds it; None elsewhere.

    A mode of the plant that grows, see `escapes`, runs away from any state in which it is large, whatever the controller answers:
    the loop is stable in the mean square neither near its rest nor far from it.

    Args:
        loop: the loop; beyond a limit its plant acts as at the limit.
        verdict: the refusal of the loop within its limits.
        limits: largest command, (m,); inf where there is none.
        named: what departs, as phrases.
    """
    rates, left = np.linalg.eig(loop.stacked.A.T)
    held = [bool(np.isfinite(limits[np.abs(mode @ loop.stacked.B) > 0.0]).all()) for mode in left.T]
    rate = float(np.abs(rates[held]).max(initial=0.0))
    if rate <= 1.0 + ROUNDING:
        return None
    return replace(
        verdict, kind="practical stability",
        reason=f"a mode of the plant that grows by {100.0 * (rate - 1.0):.3g} % in a slot is held from far enough by no command "
        f"({named}); within the limits {verdict.reason}",
        method=f"{verdict.method}; left eigenvector of the open plant",
    )  # fmt: skip


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
    its = controller_traits(controller)
    if not isinstance(controller, GainTable) or its.samples > 1 or (m, p) != (1, 1):
        return verdict
    if its.integrates and (its.order or not its.integral_limit):
        return verdict
    if loop.sc is None or loop.ca is None or loop.neglects or not_judged(loop):
        return verdict
    if loop.sc.holds.any() or loop.ca.holds.any():  # what is held has no largest age
        return verdict
    from design.networked_loop.saturated_integrator import integrator, limited_motion

    A, B, C = loop.motion.A, loop.motion.B, loop.motion.C
    delay = int(loop.sc.delay.max() + loop.ca.delay.max())
    try:
        motion = limited_motion(A, B, C, limit=float(limits[0]), delay=delay, pushes=pushes, adds=float(adds[0]))
        try:
            table = table_of(loop, controller)[:, :, 0, : p + its.order]
            ends, surely = motion.ends_in_every_order(table, np.array(its.state_gains) if its.order else None), True
        except DesignError:
            if loop.sc.open or loop.ca.open or its.order:
                return verdict
            gains, chances = _acting(closed, integrator(A, C)[1], int(loop.ca.delay.max()))
            ends, surely = motion.ends_in_mean(gains, chances), False
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
