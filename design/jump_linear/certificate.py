"""What is known of a closed loop, computed from its gains and nothing else: stability and norms.

A solver's word is not used: the matrices of every inequality are found again for the given gains, and the inequality's
eigenvalues are computed at these matrices.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from msgspec import Struct
from msgspec.structs import asdict, replace

from design.jump_linear import MJLS, STABILITY_MARGIN
from design.jump_linear.order_of_modes import parts
from design.jump_linear.second_moment import EIG_DENSE_LIMIT, Array, backward, cost_once, expect, like_units, mean_square_radius
from design.jump_linear.stability_proof import BUDGET, OPEN, side_of_one
from design.verdict import State

MOST_UNKNOWNS = 2_000_000
"""Numbers of the second moments that are computed with: some twenty seconds of an idle core. Beyond, one product lasts a second
in C, in which no Ctrl-C is seen, and the vectors of ARPACK fill the memory: 40 of 16 MB here."""
CLEAR = 1.0 - 1e-4
"""Radius below which a solution that was not found says something of the solver, and not of the loop."""


class Certificate(Struct, frozen=True, kw_only=True):
    """Stability and norms of one closed loop, with the eigenvalues of the inequalities that prove them.

    Args:
        mean_square_radius: spectral radius of the second-moment operator; stable if and only if < 1 (Theorem 7.1). Where no
            eigenvalue was found, the bound of it by which `design.jump_linear.stability_proof` decided.
        radius_is: ``at most`` or ``at least``, where it is such a bound; else empty.
        tail_radius: the same radius over the upper bounds of the transition probabilities, where a mode stands for a tail that
            is cut; None where the probabilities are exact. Below 1 it proves stability over the law without the cut.
        long_stay_radius: growth of E|x|^2 per slot in stays that have lasted long, where their limit is known, None elsewhere.
            Above 1 it proves the contrary, whatever the radius is where the tail is cut.
        state: ``certified``; ``refused``, a proof of the contrary; ``undecided``, where the tail that is cut decides.
        reason: what decided, in one sentence.
        stable: (7.17), made strict, holds at the matrices found, beyond rounding, whatever the tail that is cut does.
        h2_norm: H2 norm (7.20), z per unit impulse; None if not stable, or not found beside such a bound.
        hinf_norm: H-infinity norm (7.27); None if not asked for or not stable.
        lyapunov_margin: -largest eigenvalue of (7.17) at P found with right-hand side I; > 0 proves stability. Where rounding
            hides it, in units in which the states are alike.
        positivity_margin: smallest eigenvalue of these P.
        rounding: bound on the rounding error of the two margins. All three are None if the radius is not below 1.
        h2_residual: largest absolute eigenvalue of (7.21)'s residual, relative to the largest of S.
        hinf_margin: -largest eigenvalue of (7.28) at gamma (1 + 1e-6), relative; > 0 proves the norm.
        modes: number of modes; order: number of states.
        initial: distribution of the mode at the impulse of the H2 norm: "uniform", "stationary" or "given".
        selection: information pattern; output: "stacked" or "sum" z.
    """

    mean_square_radius: float
    stable: bool
    state: State
    reason: str
    tail_radius: float | None
    long_stay_radius: float | None
    h2_norm: float | None
    hinf_norm: float | None
    lyapunov_margin: float | None
    positivity_margin: float | None
    rounding: float | None
    h2_residual: float | None
    hinf_margin: float | None
    modes: int
    order: int
    selection: str
    output: str
    initial: str
    radius_is: str = ""

    def to_json(self) -> dict[str, object]:
        """Return the fields as a dictionary that `json.dumps` takes."""
        return {name: value for name, value in asdict(self).items() if name != "radius_is" or value}


def certify_system(
    system: MJLS,
    *,
    selection: str = "",
    output: str = "",
    initial: npt.ArrayLike | None = None,
    initial_law: str = "",
    between: tuple[Array, Array] | None = None,
    stays: Sequence[Array] = (),
    hinf: bool = False,
) -> Certificate:
    """Certify a jump-linear system: radius, norms and inequality margins.

    Where a mode stands for many whose transition probabilities differ, (7.17) is taken at the entrywise upper bounds:
    P - A_i' sum_j high_ij P_j A_i >= I with P > 0 is a Lyapunov function of every chain below them, with any number of modes.

    What such a mode stands for may refute, too. Let s be the limit of the probability to stay, and rho the radius of
    X_j -> sum_i p_ij A_i X_i A_i' over the modes of the other chain while this one stays, with s in p: if rho > 1, then for an
    eps > 0 rho (1 - eps) > 1, and from some slot H on every probability to stay is at least s (1 - eps). No slot ends a stay for
    sure, so that slot H is a mode of the law. The map keeps the cone of positive semi-definite X, so that an X >= 0 is multiplied
    by rho (Krein and Rutman); from x(0) with that second moment in slot H, the paths alone that never leave give
    E|x(n)|^2 >= c (rho (1 - eps))^n: it has no bound.

    Args:
        system: the system.
        selection, output: named in the certificate.
        initial: (N,) distribution of the mode at the impulse; default uniform.
        initial_law: its name, in the certificate.
        between: (N, N) entrywise lower and upper bounds of the transition probabilities; default exact.
        stays: (N, N) transition probabilities each, of stays that have lasted long, see `joint_stays`.
        hinf: compute the H-infinity norm too.

    Returns:
        The certificate; a loop that is not stable gives one with ``stable = False``.
    """
    A, B, C, D, transition = system.matrices
    alpha = system.alpha(initial)
    large = too_large(system.modes, system.order)
    radius = float("nan") if large else system.radius(bounded=False)
    tail_radius = None if large or between is None else mean_square_radius(A, between[1], bounded=False)
    growth = None if large else max((_radius_while(A, while_staying) for while_staying in stays), default=None)
    h2 = residual = norm = hinf_margin = lyapunov = positivity = rounding = None
    stable, worst = False, transition if between is None else between[1]
    side = side_of_one(A, worst) if not large and np.isnan(radius if tail_radius is None else radius + tail_radius) else OPEN
    if side.stable is None and radius < 1.0 and (tail_radius is None or tail_radius < 1.0):
        identity = np.broadcast_to(np.eye(system.order), A.shape)
        weight = C.transpose(0, 2, 1) @ C
        if between is None:
            P, S = cost_once(A, transition, np.stack([identity, weight]))
        else:
            P, S = cost_once(A, worst, identity), cost_once(A, transition, weight)
        if not (np.isfinite(P).all() and np.isfinite(S).all()):  # too near 1 for the solver, or too many modes: nothing is proved
            side = side_of_one(A, worst) if radius < CLEAR else side
            P, S = np.zeros_like(P), np.zeros_like(S)
        lyapunov, positivity, rounding = _margins(A, worst, P)
        energy = B.transpose(0, 2, 1) @ expect(transition, S) @ B + D.transpose(0, 2, 1) @ D
        h2 = float(np.sqrt(max(0.0, float(np.einsum("i,ijj->", alpha, energy)))))
        gap = backward(A, transition, S) + weight - S
        residual = float(np.abs(np.linalg.eigvalsh(gap)).max() / max(float(np.abs(S).max()), 1e-300))
        stable = lyapunov > rounding and positivity > rounding
    bound = ""
    if side.stable:
        stable, lyapunov, positivity, rounding, h2, residual = True, side.falls, side.least, side.rounding, None, None
        tail_radius = side.bound if tail_radius is not None and np.isnan(tail_radius) else tail_radius
    if side.stable is not None and np.isnan(radius) and (side.stable or between is None):
        radius, bound = side.bound, "at most" if side.stable else "at least"
    state, reason = _judge(system, radius, bound, tail_radius, growth, stable, between, large)
    if state == "undecided" and reason.endswith(ROUNDED) and (alike := in_like_units(system)) is not None:
        return certify_system(
            alike, selection=selection, output=output, initial=initial, initial_law=initial_law, between=between, stays=stays,
            hinf=hinf,
        )  # fmt: skip
    if hinf and h2 is not None and stable:
        from design.jump_linear.bounded_real import bounded_real_margin, hinf_norm

        norm = hinf_norm(system)
        hinf_margin = bounded_real_margin(system, norm * (1.0 + 1e-6))
    return Certificate(
        mean_square_radius=radius, stable=stable, state=state, reason=reason, tail_radius=tail_radius,
        long_stay_radius=growth, h2_norm=h2 if stable else None, hinf_norm=norm,
        lyapunov_margin=lyapunov, positivity_margin=positivity, rounding=rounding,
        h2_residual=residual, hinf_margin=hinf_margin, modes=system.modes, order=system.order, selection=selection,
        output=output, initial="given" if initial is not None and not initial_law else initial_law or "uniform", radius_is=bound,
    )  # fmt: skip


def too_large(modes: int, order: int) -> str:
    """Return why a system is too large for its second moments to be computed; empty if it is not.

    Args:
        modes: their number.
        order: number of states.
    """
    unknowns = modes * order * (order + 1) // 2
    if modes == 1 or unknowns <= MOST_UNKNOWNS:
        return ""
    return (
        f"the network has {modes} modes over {order} states, whose second moments are {unknowns} numbers, more than the "
        f"{MOST_UNKNOWNS} that are computed with: laws with fewer ages or modes are decided"
    )


ROUNDED = "too close to 1 for floating point"


def _margins(A: Array, transition: Array, P: Array) -> tuple[float, float, float]:
    """By how much (7.17) falls at P, the smallest eigenvalue of P, and a bound of the rounding error of both."""
    scale = float(np.abs(P).max() * max(1.0, float((np.abs(A).sum(axis=2) ** 2).max())))
    rounding = 4.0 * A.shape[-1] * len(A) * float(np.finfo(float).eps) * scale
    return -_largest(backward(A, transition, P) - P), -_largest(-P), rounding


def in_like_units(system: MJLS) -> MJLS | None:
    """Return a system in the units of `like_units`; None where it is in such units already."""
    A, B, C, _, _ = system.matrices
    unit = like_units(A)
    return None if unit is None else replace(system, A=A * unit / unit[:, None], B=B / unit[:, None], C=C * unit)


def grows(A: Array, transition: Array, radius: float) -> bool:
    r"""Whether a second-moment radius above 1 is no rounding: eigenvalues that are nearly equal are moved far by it.

    .. math:: P_i - s^{-1} A_i' \textstyle\sum_j p_{ij} P_j A_i > 0, \qquad P \not\ge 0

    proves that the radius is at least s, as in `design.jump_linear.stability_proof`, which decides for the largest systems. Of
    modes that do not lead to each other one class that grows is enough.

    Args:
        A: (N, n, n) mode matrices.
        transition: (N, N) transition probabilities, or lower bounds of them.
        radius: as it was computed.
    """
    return any(_grows(*each, radius) for each in parts(A, transition))


def _grows(A: Array, transition: Array, radius: float) -> bool:
    if len(A) > 1 and A.shape[0] * A.shape[1] * (A.shape[1] + 1) // 2 > EIG_DENSE_LIMIT:
        return side_of_one(A, transition, near=False).stable is False
    for share in (0.5, 0.1, 0.9):
        one = A / np.sqrt(radius**share)
        try:
            P = cost_once(one, transition, np.broadcast_to(np.eye(A.shape[-1]), A.shape))
        except np.linalg.LinAlgError:  # singular
            continue
        if np.isfinite(P).all():
            falls, least, rounding = _margins(one, transition, P)
            if falls > rounding and least < -rounding:
                return True
    return False


def _judge(
    system: MJLS, radius: float, bound: str, tail_radius: float | None, growth: float | None, stable: bool,
    between: tuple[Array, Array] | None, large: str,
) -> tuple[State, str]:
    """What follows from the radii and the margins, in words."""
    if large:
        return "undecided", large
    A, _, _, _, transition = system.matrices
    tail = "" if tail_radius is None else f", {tail_radius:.6g} over the bounds of the tail that is cut"
    size = f"{bound} {radius:.6g}".lstrip()
    if stable:
        return "certified", f"the second-moment radius is {size}{tail}, below 1"
    least = radius if between is None else mean_square_radius(A, between[0])
    if least > 1.0 + STABILITY_MARGIN:
        size = size if between is None else f"{least:.6g}"
        if not bound and not grows(A, transition if between is None else between[0], least):
            return "undecided", f"the second-moment radius is {size} as it is computed: {ROUNDED}"
        return "refused", f"the loop is not mean-square stable: the second-moment radius is {size}, expected below 1"
    if growth is not None and growth > 1.0 + STABILITY_MARGIN:
        return "refused", (
            "the loop is not mean-square stable: of a sojourn that has lasted long the end becomes so unlikely that the second "
            f"moment grows by {growth:.6g} per slot, expected below 1"
        )
    if np.isnan(radius) or np.isnan(tail_radius or 0.0):
        return "undecided", (
            f"the second-moment radius is near 1: over {len(A)} modes no eigenvalue was found, and products of {BUDGET:.1g} "
            "numbers in all did not decide"
        )
    if tail_radius is None or (radius < 1.0 and tail_radius < 1.0):
        return "undecided", f"the second-moment radius is {radius:.9g}{tail}: {ROUNDED}"
    return "undecided", (
        f"the tail of a sojourn law decides: the second-moment radius is {radius:.6g} where it is cut{tail}, expected below 1"
    )


def _radius_while(A: Array, transition: Array) -> float:
    """The second-moment radius over transition probabilities of which many rows are 0: such modes are left for ever."""
    kept = np.flatnonzero(transition.any(axis=1))
    return mean_square_radius(A[kept], transition[np.ix_(kept, kept)])


def _largest(family: Array) -> float:
    symmetric = 0.5 * (family + family.transpose(0, 2, 1))
    return float(np.linalg.eigvalsh(symmetric).max())


SEEN = 1e-7
"""Share of a direction's size below which it is rounding."""
EXACT = 1e-11
"""What T A_i - A^T_i T may be, as a share of A_i."""
GROWS = 1.0 + 1e-9
"""Second-moment radius from which on what is not seen grows."""


def observed_part(system: MJLS, shown: Array) -> tuple[MJLS, int]:
    r"""Return the system in the coordinates that its output and more rows show, and how many directions are left out.

    It is the part of a jump-linear system that its output ever shows.

    A predictor that carries a model of an integrator beside the plant has an offset that neither the plant nor the input knows: a
    state with factor 1. With the rows of T an orthonormal basis of

    .. math:: \operatorname{span} \{ C_{i_0}' ,\ A_{i_1}' C_{i_0}',\ A_{i_2}' A_{i_1}' C_{i_0}',\ \ldots \}

    T A_i = A^T_i T, so that z = T x is a jump-linear system of its own with the same output.

    None is left out unless what is left out does not grow by any factor: its second-moment radius is at most 1.

    Args:
        system: the system; C of what has to be stable.
        shown: more of what has to be stable, (l, n).
    """
    A, B, C, _, transition = system.matrices
    if (unit := like_units(A)) is not None:  # what is small in its own unit may lead back
        A, B, C, shown = A * unit / unit[:, None], B / unit[:, None], C * unit, shown * unit
    n, basis = system.order, np.zeros((0, system.order))
    front = np.vstack([shown, C.reshape(-1, n)])
    while len(front) and len(basis) < n:
        left = front - front @ basis.T @ basis
        left -= left @ basis.T @ basis
        size = np.linalg.norm(front, axis=1, keepdims=True)
        _, s, rows = np.linalg.svd(left / np.where(size > 0.0, size, 1.0), full_matrices=False)
        found = rows[s > SEEN * max(1.0, float(s[0]))]
        basis = np.vstack([basis, found])
        front = (found @ A).reshape(-1, n)
    if len(basis) == n:
        return system, 0
    inner, scale = basis @ A @ basis.T, max(1.0, float(np.abs(A).max()))
    rest = np.linalg.svd(basis)[2][len(basis) :]
    if np.abs(basis @ A - inner @ basis).max() > EXACT * scale or mean_square_radius(rest @ A @ rest.T, transition) > GROWS:
        return system, 0
    return replace(system, A=inner, B=basis @ B, C=C @ basis.T), n - len(basis)
