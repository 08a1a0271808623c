"""Tracking designs for networked loops: H2, H-infinity and mixed static output feedback, certified.

Direct descent on the norm itself over the free gains, with exact derivatives: the gains are the only unknowns, and
every iterate is a stable loop with a known norm. The thesis iterates linear matrix inequalities in the Lyapunov
matrices instead, hundreds of unknowns and hours (`design.as_printed.cone_complementarity`); ours takes about a second and
ends no worse.

    >>> from design.tracking.synthesis import TrackingProblem, solve
    >>> design = solve(TrackingProblem(A=[[0.9]], B=[[1.0]], C=[[1.0]], sc=[[1.0]], ca=[[1.0]], R=0.5))
    >>> design.certificate.stable, round(float(design.gains[0, 0, 0, 0]), 3)
    (True, -0.741)
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace

import numpy as np
from msgspec import Struct

from design.errors import DesignError, FieldError, Infeasible, NotStable
from design.jump_linear.certificate import Certificate
from design.networked_loop.certify import LowerBounds, certify_structure, lower_bounds
from design.processes.delay_chain import Array, Index
from design.tracking import COARSER, DEFAULT_STARTS, MOST_STATES, TrackingProblem, embed, state_gains_of
from design.tracking.bfgs import Descent, bfgs
from design.tracking.local_design import lqr_feedback
from design.tracking.loop_objective import LoopObjective, check_plant, closed_classes, stabilising

__all__ = ["Design", "Progress", "TrackingProblem", "solve"]

Progress = Callable[[str, int, int, float], None]
BARRIER_WEIGHTS = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
MIXED_SLACK = 1.05
CHEAP = 0.01
"""Weight of the input in the state feedback from which stable gains are searched for, output units per input unit."""
RANDOM_STARTS = 3
"""Of the search for first gains that are stable."""
ROUGH = 1e-6
"""Relative gain below which a descent stops whose result is only a start."""


class Design(Struct, frozen=True, kw_only=True):
    """Gains with everything known of them.

    Args:
        problem: what was asked.
        gains: (tau labels, rows, m, py), convention u = u* + K[tau, row] (y - r).
        certificate: computed from the gains.
        bounds: lower bounds for any causal controller; None for the sum z, for which none hold.
        starts: value of every start of the multistart, inf where it found no stable gains.
        evaluations: number of norms computed.
    """

    problem: TrackingProblem
    gains: Array
    certificate: Certificate
    bounds: LowerBounds | None
    starts: tuple[float, ...]
    evaluations: int

    @property
    def selection(self) -> str:
        """Row rule by which the gains run."""
        return self.problem.selection

    @property
    def gap(self) -> float | None:
        """How far the design's norm may be from that of the best causal controller: norm / lower bound - 1."""
        c = self.certificate
        if self.bounds is None or c.h2_norm is None or c.hinf_norm is None:
            return None
        if self.problem.objective == "hinf":
            return c.hinf_norm / self.bounds.hinf_delayed_information - 1.0
        return c.h2_norm / self.bounds.h2_delayed_information - 1.0


def solve(problem: TrackingProblem, *, progress: Progress | None = None) -> Design:
    """Solve a tracking problem; the same problem gives the same gains on every call.

    Args:
        problem: what is asked.
        progress: called with (stage, start, starts, value) now and then.

    Raises:
        NotStable: no gains stabilise the loop; `value` is the radius (or eigenvalue) that decides it.
        Infeasible: a mixed bound below the smallest H-infinity norm found, which is `value`.
    """
    import scipy.linalg  # noqa: F401 - it brings a BLAS of its own, and only those that are loaded are held to one thread

    from design.whole_process import one_blas_thread

    if problem.method != "direct":
        raise FieldError("method", f"{problem.method!r} is not solved here; as_printed.cone_complementarity.design_by_ccl has it")
    with one_blas_thread():
        structure, space = problem.structure(), problem.space()
        check_plant(*(np.asarray(M, dtype=np.float64) for M in (problem.A, problem.B, problem.C)))
        objective = LoopObjective(structure, space, problem.alpha(structure))
        best, values = _multistart(problem, objective, progress)
        return certified(problem, space.gains(best.x), starts=values, evaluations=objective.evaluations)


def certified(problem: TrackingProblem, gains: Array, *, starts: tuple[float, ...], evaluations: int) -> Design:
    """A design from its gains, with everything that is known of it computed from them.

    Raises:
        NotStable: the gains have no certificate.
        ValueError: their shape does not fit the problem.
    """
    from design.whole_process import one_blas_thread

    with one_blas_thread():  # and one order of the sums: a cached design has the same certificate
        structure = problem.structure()
        certificate = certify_structure(structure, gains, output=problem.output, initial=problem.initial, hinf=True)
    if not certificate.stable:
        raise NotStable(
            f"the gains found have no certificate: radius {certificate.mean_square_radius:.9g}; {certificate.reason}",
            value=certificate.mean_square_radius,
        )
    bounds = None
    if problem.output == "stacked":
        A, B, C = (np.asarray(M, dtype=np.float64) for M in (problem.A, problem.B, problem.C))
        Q = C if problem.Q is None else np.atleast_2d(np.asarray(problem.Q, dtype=np.float64))
        # the norm's own weights, of the pairs (tau, d): `previous` has modes that differ in the delay before only
        sc, ca = problem.chains
        pair, pairs = structure.sc_mode * ca.modes + structure.ca_mode, sc.modes * ca.modes
        weights, present = np.bincount(pair, problem.alpha(structure), pairs), np.bincount(pair, minlength=pairs) > 0
        bounds = lower_bounds(A, B, Q, sc, ca, weights, present)
    return Design(problem=problem, gains=gains, certificate=certificate, bounds=bounds, starts=starts, evaluations=evaluations)


def _multistart(
    problem: TrackingProblem, objective: LoopObjective, progress: Progress | None, *, rough: bool = False
) -> tuple[Descent, tuple[float, ...]]:
    """Descend from every start; roughly where the result is only a start itself."""
    count = problem.starts or DEFAULT_STARTS[str(problem.objective)]
    rng = np.random.default_rng(problem.seed)
    report = progress or (lambda stage, start, starts, value: None)
    first = _first_stable(problem, objective)
    centre = _descend(objective.descend_h2, first)
    report("h2", 1, count, centre.value)
    results: list[Descent] = []
    for start in range(count):
        v = centre.x if start == 0 else _other_start(problem, objective, start, centre.x, rng)
        if v is None:
            results.append(Descent(centre.x, np.inf, centre.gradient, 0, 0, "not stable"))
            continue
        if problem.objective == "h2":
            result = centre if start == 0 else _descend(objective.descend_h2, v)
        elif problem.objective == "hinf":
            result = objective.descend_hinf(v, ROUGH) if rough else _descend(objective.descend_hinf, v)
        else:
            result = _mixed(problem, objective, v)
        results.append(result)
        report(str(problem.objective), start + 1, count, min(r.value for r in results))
    best = min(results, key=lambda r: r.value)
    if not np.isfinite(best.value):
        radius = objective.radius(centre.x)
        raise NotStable(f"no start of {count} ended at a stable loop; best second-moment radius {radius:.9g}", value=radius)
    return best, tuple(float(r.value) for r in results)


def _first_stable(problem: TrackingProblem, objective: LoopObjective) -> Array:
    """Return coordinates of stable gains: the first that are found from `_stable_starts`.

    Raises:
        NotStable: none were found; that is no proof that there are none.
    """
    radii = []
    for start in _stable_starts(problem, objective):
        try:
            return stabilising(objective, start)
        except NotStable as error:
            radii.append(np.inf if error.value is None else float(error.value))
    advice = f"order = {problem.order + 1} (states of its own), " if problem.order < MOST_STATES else ""
    advice += "samples = 2, " if problem.samples == 1 and problem.chains[0].ages is None else ""
    found = NotStable(
        f"no gains found that make the loop mean-square stable: none in {len(radii)} starts of the search, best second-moment "
        f"radius {min(radii):.6g}, expected < 1; that is no proof that there are none: try {advice}another information pattern, "
        "another period, or a controller with an observer, such as local-designed",
        value=min(radii),
    )
    raise _with_class(problem, objective, found)


def _stable_starts(problem: TrackingProblem, objective: LoopObjective) -> Iterator[Array]:
    """Coordinates from which stable gains are searched for: zero, a state feedback, random ones.

    A controller's own state begins as the samples before; from zero, where it moves no input, no descent would leave.
    """
    none = np.zeros(objective.space.shape)
    if problem.order:
        made, shown = state_gains_of(none, problem.order)[1], _shown(problem, none.shape[3])
        made[..., shown] = np.eye(problem.order, len(shown))
    zero = objective.space.coordinates(none)
    yield zero
    with suppress(DesignError):  # an eigenvalue on the unit circle that z does not see
        yield objective.space.coordinates(none + _state_feedback(problem, objective.space.shape))
    rng = np.random.default_rng((problem.seed, RANDOM_STARTS))
    for _ in range(RANDOM_STARTS):
        yield zero + 0.1 * rng.standard_normal(zero.shape)


def _state_feedback(problem: TrackingProblem, shape: tuple[int, int, int, int]) -> Array:
    """Return gains (shape) of a linear-quadratic state feedback, of the state that the samples of a packet show.

    At a short period the gains on two samples are large and of opposite signs, far from zero. The samples, and those before
    them in a controller's own state, are taken as those of a plant without input, and carried over the S-C delay. The gains on
    an integral are 0.

    Raises:
        DesignError: the Riccati equation has no stabilising solution.
    """
    A, B, C = (np.asarray(M, dtype=np.float64) for M in (problem.A, problem.B, problem.C))
    feedback, last = -lqr_feedback(A, B, C, CHEAP), problem.samples - 1 + problem.order // len(C)
    oldest = np.linalg.pinv(np.concatenate([C @ np.linalg.matrix_power(A, last - i) for i in range(last + 1)]))
    gains = np.zeros(shape)
    rows, shown = state_gains_of(gains, problem.order)[0], _shown(problem, shape[3])
    for label, delay in enumerate(problem.chains[0].label_delay.clip(0)):
        rows[label][..., shown[: oldest.shape[1]]] = feedback @ np.linalg.matrix_power(A, int(delay) + last) @ oldest
    return gains


def _shown(problem: TrackingProblem, known: int) -> Index:
    """Return which of what the gains know are samples, or a controller's own state, and no sum of errors."""
    seen = problem.samples * len(np.asarray(problem.C))
    return np.append(np.arange(seen), np.arange(known - problem.order, known))


def _other_start(
    problem: TrackingProblem, objective: LoopObjective, start: int, centre: Array, rng: np.random.Generator
) -> Array | None:
    """Start 1 is the optimum of a coarser information pattern; then random ones, near first, later far."""
    space = objective.space
    if start == 1 and problem.objective != "h2" and problem.information in COARSER and not problem.order:
        coarser = replace(problem, information=COARSER[problem.information], starts=2, hinf_bound=None, initial=None)
        if coarser.objective == "mixed":
            coarser = replace(coarser, objective="hinf")
        structure, free = coarser.structure(), coarser.space()
        best, _ = _multistart(coarser, LoopObjective(structure, free, coarser.alpha(structure)), None, rough=True)
        return space.coordinates(embed(free.gains(best.x), space.shape[1]))
    K = space.gains(centre)
    spread = float(np.abs(K).max()) * 2.0 ** (start % 4 - 1)  # some optima have gains ten times those of the H2 one
    K = K * rng.choice([-1.0, 0.0, 1.0, 2.0], K.shape) + spread * rng.standard_normal(K.shape)
    try:
        return stabilising(objective, space.coordinates(K))
    except NotStable:
        return None


def _descend(descent: Callable[[Array], Descent], start: Array) -> Descent:
    """Descent, then once more with a forgotten Hessian: what an ill-conditioned valley leaves is taken there."""
    first = descent(start)
    return first if first.reason == "gradient" else descent(first.x)


def _mixed(problem: TrackingProblem, objective: LoopObjective, start: Array) -> Descent:
    """H2 descent behind a logarithmic barrier at the H-infinity bound, the barrier falling away."""
    v, bound = start, problem.hinf_bound
    norm, _ = objective.hinf(v)
    if bound is None:
        inside = _descend(objective.descend_hinf, v)
        v, bound = inside.x, MIXED_SLACK * inside.value
    elif norm >= bound:
        goal = bound * (1.0 - 1e-4)
        inside = bfgs(objective.hinf, v, stop=lambda value: value < goal)
        if inside.value >= bound:
            inside = _descend(objective.descend_hinf, inside.x)
        if inside.value >= bound:
            raise Infeasible(
                f"hinf_bound: {bound:.6g} is not reached; the smallest H-infinity norm found is {inside.value:.6g}",
                value=inside.value,
            )
        v = inside.x
    result = Descent(v, np.inf, v, 0, 0, "")
    for weight in BARRIER_WEIGHTS:
        result = bfgs(_barrier(objective, float(bound), weight * objective.h2(v)[0]), v, iterations=150, value_tolerance=1e-10)
        v = result.x
    return result._replace(value=objective.h2(v)[0])


def _barrier(objective: LoopObjective, bound: float, weight: float) -> Callable[[Array], tuple[float, Array]]:
    """H2 norm - weight * log(1 - H-infinity norm / bound)."""

    def value(x: Array) -> tuple[float, Array]:
        h2, slope = objective.h2(x)
        if not np.isfinite(h2):
            return np.inf, slope
        hinf, hinf_slope = objective.hinf(x)
        room = 1.0 - hinf / bound
        if not room > 0.0:
            return np.inf, slope
        return h2 - weight * float(np.log(room)), slope + weight / (room * bound) * hinf_slope

    return value


def _with_class(problem: TrackingProblem, objective: LoopObjective, error: NotStable) -> NotStable:
    """Name the closed class of modes that cannot be stabilised by itself, if the chain has one that is not everything."""
    transition = objective.structure.transition
    s = objective.structure
    for members in closed_classes(transition):
        if members.size == transition.shape[0]:
            continue
        sc, ca = problem.chains
        modes = ", ".join(f"(tau={sc.delay[s.sc_mode[i]]}, d={ca.delay[s.ca_mode[i]]})" for i in members[:4]) + (
            ", ..." if members.size > 4 else ""
        )
        return NotStable(
            f"the chain never leaves the modes {modes}, and no gains were found that keep the loop mean-square stable: "
            f"smallest radius reached {error.value:.6g}, expected < 1",
            value=error.value,
        )
    return error
