"""What is known of a closed loop, computed from its gains and nothing else: stability, norms, where bounded signals push it.

A solver's word is not used: the matrices of every inequality are found again for the given gains, and the inequality's
eigenvalues are computed at these matrices.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from msgspec import Struct
from msgspec.structs import asdict

from design.errors import NotStable
from design.jump_linear.mjls import MJLS, STABILITY_MARGIN
from design.jump_linear.second_moment import Array, backward, cost_once, expect, mean_square_radius
from design.verdict import State

MOST_UNKNOWNS = 2_000_000
"""Numbers of the second moments that are computed with: some twenty seconds of an idle core. Beyond, one product lasts a second
in C, in which no Ctrl-C is seen, and the vectors of ARPACK fill the memory: 40 of 16 MB here."""


class Certificate(Struct, frozen=True, kw_only=True):
    """Stability and norms of one closed loop, with the eigenvalues of the inequalities that prove them.

    Args:
        mean_square_radius: spectral radius of the second-moment operator; stable if and only if < 1 (Theorem 7.1).
        tail_radius: the same radius over the upper bounds of the transition probabilities, where a mode stands for a tail that
            is cut; None where the probabilities are exact. Below 1 it proves stability over the law without the cut.
        long_stay_radius: growth of E|x|^2 per slot in stays that have lasted long, where their limit is known, None elsewhere.
            Above 1 it proves the contrary, whatever the radius is where the tail is cut.
        state: ``certified``; ``refused``, a proof of the contrary; ``undecided``, where the tail that is cut decides.
        reason: what decided, in one sentence.
        stable: (7.17), made strict, holds at the matrices found, beyond rounding, whatever the tail that is cut does.
        h2_norm: H2 norm (7.20), z per unit impulse; None if not stable.
        hinf_norm: H-infinity norm (7.27); None if not asked for or not stable.
        lyapunov_margin: -largest eigenvalue of (7.17) at P found with right-hand side I; > 0 proves stability.
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

    def to_json(self) -> dict[str, object]:
        """Return the fields as a dictionary that `json.dumps` takes."""
        return asdict(self)


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
    radius = float("nan") if large else system.radius()
    tail_radius = None if large or between is None else mean_square_radius(A, between[1])
    growth = None if large else max((_radius_while(A, while_staying) for while_staying in stays), default=None)
    h2 = residual = norm = hinf_margin = lyapunov = positivity = rounding = None
    stable = False
    if radius < 1.0 and (tail_radius is None or tail_radius < 1.0):
        identity = np.broadcast_to(np.eye(system.order), A.shape)
        weight = C.transpose(0, 2, 1) @ C
        worst = transition if between is None else between[1]
        if between is None:
            P, S = cost_once(A, transition, np.stack([identity, weight]))
        else:
            P, S = cost_once(A, worst, identity), cost_once(A, transition, weight)
        if not (np.isfinite(P).all() and np.isfinite(S).all()):  # too near 1 for the solver: nothing is proved
            P, S = np.zeros_like(P), np.zeros_like(S)
        lyapunov = -_largest(backward(A, worst, P) - P)
        positivity = -_largest(-P)
        scale = float(np.abs(P).max() * max(1.0, float((np.abs(A).sum(axis=2) ** 2).max())))
        rounding = 4.0 * system.order * system.modes * float(np.finfo(float).eps) * scale
        energy = B.transpose(0, 2, 1) @ expect(transition, S) @ B + D.transpose(0, 2, 1) @ D
        h2 = float(np.sqrt(max(0.0, float(np.einsum("i,ijj->", alpha, energy)))))
        gap = backward(A, transition, S) + weight - S
        residual = float(np.abs(np.linalg.eigvalsh(gap)).max() / max(float(np.abs(S).max()), 1e-300))
        stable = lyapunov > rounding and positivity > rounding
    state, reason = _judge(A, radius, tail_radius, growth, stable, between, large)
    if hinf and stable:
        from design.jump_linear.bounded_real import bounded_real_margin, hinf_norm

        norm = hinf_norm(system)
        hinf_margin = bounded_real_margin(system, norm * (1.0 + 1e-6))
    return Certificate(
        mean_square_radius=radius, stable=stable, state=state, reason=reason, tail_radius=tail_radius,
        long_stay_radius=growth, h2_norm=h2 if stable else None, hinf_norm=norm,
        lyapunov_margin=lyapunov, positivity_margin=positivity, rounding=rounding,
        h2_residual=residual, hinf_margin=hinf_margin, modes=system.modes, order=system.order, selection=selection,
        output=output, initial="given" if initial is not None and not initial_law else initial_law or "uniform",
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


def _judge(
    A: Array, radius: float, tail_radius: float | None, growth: float | None, stable: bool,
    between: tuple[Array, Array] | None, large: str,
) -> tuple[State, str]:
    """What follows from the radii and the margins, in words."""
    if large:
        return "undecided", large
    tail = "" if tail_radius is None else f", {tail_radius:.6g} over the bounds of the tail that is cut"
    if stable:
        return "certified", f"the second-moment radius is {radius:.6g}{tail}, below 1"
    least = radius if between is None else mean_square_radius(A, between[0])
    if least > 1.0 + STABILITY_MARGIN:
        return "refused", f"the loop is not mean-square stable: the second-moment radius is {least:.6g}, expected below 1"
    if growth is not None and growth > 1.0 + STABILITY_MARGIN:
        return "refused", (
            "the loop is not mean-square stable: of a sojourn that has lasted long the end becomes so unlikely that the second "
            f"moment grows by {growth:.6g} per slot, expected below 1"
        )
    if tail_radius is None or (radius < 1.0 and tail_radius < 1.0):
        return "undecided", f"the second-moment radius is {radius:.9g}{tail}: too close to 1 for floating point"
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


SHARE = 1e-3
"""What of a bound may be left to the end of its sum."""
TERMS = 100_000


def ultimate_bound(A: Array, transition: Array, E: Array, C: Array) -> Array:
    r"""Return what the root mean square of C x ends within, the share of each signal, (q,); their sum is the bound.

    It holds for a stable system, whatever the bounded signals are that push it.

    .. math:: x(k+1) = A_i x(k) + \sum_q E_i^q e_q(k), \qquad |e_q(k)| \le 1, \qquad z = C x

    By Minkowski's inequality in the mean square, with M_0 = C'C and M_{t+1} = L M_t, the cost operator of `second_moment`,

    .. math:: \limsup_k \sqrt{E |z(k)|^2} \le \sum_q \sum_t \sqrt{\max_i E_i^{q\prime} (\textstyle\sum_j p_{ij} M_t^j) E_i^q}

    whatever e(k) knows of the modes and states up to slot k. The sum over t is ended where what follows is known to be small:
    with P - L P >= I, L P <= (1 - 1/|P|) P.

    Args:
        A: (N, n, n) mode matrices of a mean-square stable system.
        transition: (N, N) transition probabilities, or upper bounds of them over which it is stable.
        E: (N, n, q), what signals of size 1 push.
        C: (l, n), what is asked for.

    Raises:
        NotStable: so near the edge that no bound was found.
    """
    P = cost_once(A, transition, np.broadcast_to(np.eye(A.shape[-1]), A.shape))
    largest = float(np.linalg.eigvalsh(P)[:, -1].max())
    if not 1.0 <= largest < 1e14 or float(np.linalg.eigvalsh(P)[:, 0].min()) < 1.0 - 1e-6:
        raise NotStable("no bound was found: the loop is too near to one that is not mean-square stable")
    left = np.sqrt(_reached(expect(transition, P), E)) / (1.0 - np.sqrt(max(1.0 - 1.0 / largest, 0.0)))
    M, total = np.broadcast_to(C.T @ C, A.shape), np.zeros(E.shape[-1])
    for _ in range(TERMS):
        total = total + np.sqrt(_reached(expect(transition, M), E))
        M = backward(A, transition, M)
        tail = np.sqrt(max(float(np.linalg.eigvalsh(M)[:, -1].max()), 0.0)) * left
        if (tail <= SHARE * total).all():
            return np.asarray(total + tail)
    raise NotStable("no bound was found: the loop is too near to one that is not mean-square stable")


def _reached(M: Array, E: Array) -> Array:
    """max_i E_i^q' M_i E_i^q, (q,)."""
    return np.asarray(np.maximum(np.einsum("iaq,iab,ibq->iq", E, M, E), 0.0).max(axis=0))
