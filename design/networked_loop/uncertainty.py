"""Norm-bounded plant uncertainty of Remark 7.6: how much a networked loop bears, and what it guarantees under it.

    x(k+1) = (A + dA) x + (B + dB) (u + w),    [dA dB] = M Delta(k) [N1 N2],    |Delta(k)| <= 1

Delta closes a loop from q = N1 x + N2 (u + w) to x(k+1) through M. It may change with time and depend on the past, so
the small-gain condition in the H-infinity norm of that channel is what counts, and for every multiplier lambda > 0

    P_i >= A_i' E_i(P) A_i + C'C + lambda N_i'N_i + (..)' (lambda I - M' E_i(P) M)^-1 (..)

bounds the H2 norm over all such Delta. The bounds are sound for every Delta.

Remark 7.6 overlooks one thing: in coordinates of deviation, dA x* + dB u* is an input that does not fade. The bounds
here are for the disturbance response, not for the offset that a wrong model leaves (only integral action removes it).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from design.errors import FieldError, Infeasible
from design.jump_linear import MJLS, h2_norm
from design.jump_linear.bounded_real import hinf_norm, solve_bounded_real
from design.jump_linear.second_moment import expect
from design.networked_loop import check_gains
from design.networked_loop.affine_loop import LoopStructure
from design.processes.delay_chain import Array

TOLERANCE = 1e-5
"""Of the bound of the H-infinity norm, relative; it lies above."""
DECADES, NEAR = 20.0, 1e-3
"""Over how many decades a multiplier is searched, and how exactly, in decades."""


class RobustNorms(NamedTuple):
    """Guaranteed norms under all |Delta| <= 1."""

    h2: float
    hinf: float


class _Channel(NamedTuple):
    A: Array
    B: Array
    C: Array
    transition: Array
    M: Array  # (N, n, a): where Delta's output enters
    of_state: Array  # (N, b, n): q as a function of the state
    of_disturbance: Array  # (N, b, m): and of w


def uncertainty_margin(
    structure: LoopStructure, gains: npt.ArrayLike, M: npt.ArrayLike, N1: npt.ArrayLike, N2: npt.ArrayLike
) -> float:
    """Largest rho for which the small-gain theorem keeps the loop mean-square stable for all |Delta| <= rho.

    Args:
        structure, gains: the loop.
        M: (n, a).
        N1: (b, n).
        N2: (b, m).
    """
    c = _channel(structure, gains, M, N1, N2)
    norm = hinf_norm(MJLS(A=c.A, B=c.M, C=c.of_state, transition=c.transition))
    return float("inf") if norm == 0.0 else 1.0 / norm


def robust_norms(
    structure: LoopStructure, gains: npt.ArrayLike, M: npt.ArrayLike, N1: npt.ArrayLike, N2: npt.ArrayLike,
    initial: npt.ArrayLike | None = None,
) -> RobustNorms:  # fmt: skip
    """H2 and H-infinity norms that hold for every |Delta(k)| <= 1.

    Raises:
        Infeasible: the loop does not bear |Delta| <= 1; `value` is the margin, below 1.
    """
    c, low, alpha = _checked(structure, gains, M, N1, N2, initial)
    _, square = _search(low, lambda exponent, _: _h2_bound(c, alpha, 10.0**exponent))
    _, hinf = _search(low, lambda exponent, best: _hinf_bound(c, 10.0**exponent, best))
    return RobustNorms(float(np.sqrt(square)), hinf)


def robust_h2(
    structure: LoopStructure, gains: npt.ArrayLike, M: npt.ArrayLike, N1: npt.ArrayLike, N2: npt.ArrayLike,
    initial: npt.ArrayLike | None = None,
) -> tuple[float, float]:  # fmt: skip
    """The H2 norm of `robust_norms` with its multiplier, in a quarter of the time.

    Raises:
        Infeasible: as `robust_norms`.
    """
    c, low, alpha = _checked(structure, gains, M, N1, N2, initial)
    multiplier, square = _search(low, lambda exponent, _: _h2_bound(c, alpha, 10.0**exponent))
    return float(np.sqrt(square)), multiplier


def _checked(
    structure: LoopStructure, gains: npt.ArrayLike, M: npt.ArrayLike, N1: npt.ArrayLike, N2: npt.ArrayLike,
    initial: npt.ArrayLike | None,
) -> tuple[_Channel, float, Array]:  # fmt: skip
    """The channel of a loop that bears |Delta| <= 1, the least exponent of a multiplier, and the mode's law at the impulse."""
    margin = uncertainty_margin(structure, gains, M, N1, N2)
    if margin <= 1.0:
        raise Infeasible(f"uncertainty: the loop bears |Delta| up to {margin:.6g}, expected more than 1", value=margin)
    c = _channel(structure, gains, M, N1, N2)
    system = MJLS(A=c.A, B=c.B, C=c.C, transition=c.transition)
    alpha = system.alpha(structure.default_initial if initial is None else initial)
    moved = MJLS(A=c.A, B=c.B, C=c.of_state, D=c.of_disturbance, transition=c.transition)
    centre = 2.0 * float(np.log10(h2_norm(system) / max(h2_norm(moved), 1e-150)))
    return c, centre - DECADES / 3.0, alpha


def guaranteed_h2(
    structure: LoopStructure, gains: npt.ArrayLike, M: npt.ArrayLike, N1: npt.ArrayLike, N2: npt.ArrayLike, alpha: Array,
    multiplier: float,
) -> float:  # fmt: skip
    """H2 norm that holds for every |Delta(k)| <= 1 by one multiplier, inf where it proves none.

    Args:
        structure, gains, M, N1, N2: as `uncertainty_margin`.
        alpha: (N,) distribution of the mode at the impulse.
        multiplier: lambda above 0.
    """
    return float(np.sqrt(_h2_bound(_channel(structure, gains, M, N1, N2), alpha, multiplier)))


def _channel(structure: LoopStructure, gains: npt.ArrayLike, M: npt.ArrayLike, N1: npt.ArrayLike, N2: npt.ArrayLike) -> _Channel:
    K = check_gains(gains, structure.gain_shape)
    n, m = structure.plant_order, structure.gain_shape[2]
    M_, N1_, N2_ = (np.atleast_2d(np.asarray(v, dtype=np.float64)) for v in (M, N1, N2))
    for name, value, axis, size in (("M", M_, 0, n), ("N1", N1_, 1, n), ("N2", N2_, 1, m)):
        if value.shape[axis] != size or not np.isfinite(value).all():
            raise FieldError(name, f"shape {value.shape}, expected {size} {'rows' if axis == 0 else 'columns'}")
    if N1_.shape[0] != N2_.shape[0]:
        raise FieldError("N2", f"{N2_.shape[0]} rows, expected {N1_.shape[0]} as N1 has")
    modes, order = structure.base.shape[:2]
    enter = np.zeros((modes, order, M_.shape[1]))
    enter[:, :n] = M_
    of_state = N2_ @ structure.applied_input(K)
    of_state[:, :, :n] += N1_
    of_disturbance = np.zeros((modes, len(N2_), structure.B.shape[2]))
    of_disturbance[:, :, :m] = N2_  # a step of the reference moves the state, and no input
    return _Channel(structure.matrices(K), structure.B, structure.C, structure.transition, enter, of_state, of_disturbance)


def _h2_bound(c: _Channel, alpha: Array, multiplier: float) -> float:
    """Guaranteed squared H2 norm for one multiplier, inf if there is none."""
    root = float(np.sqrt(multiplier))
    zero = np.zeros((c.A.shape[0], c.C.shape[1] + c.of_state.shape[1], c.M.shape[2]))
    output = np.concatenate([c.C, root * c.of_state], axis=1)
    policy = solve_bounded_real((c.A, c.M / root, output, zero, c.transition), 1.0)
    if policy is None:
        return np.inf
    E = expect(c.transition, policy.P)
    EM = E @ c.M
    rest = multiplier * np.eye(c.M.shape[2]) - c.M.transpose(0, 2, 1) @ EM
    BEM = c.B.transpose(0, 2, 1) @ EM
    energy = (
        c.B.transpose(0, 2, 1) @ E @ c.B
        + multiplier * c.of_disturbance.transpose(0, 2, 1) @ c.of_disturbance
        + BEM @ np.linalg.solve(rest, BEM.transpose(0, 2, 1))
    )
    return float(np.einsum("i,ijj->", alpha, energy))


def _hinf_bound(c: _Channel, multiplier: float, best: float) -> float:
    """Smallest gamma with |z|^2 - gamma^2 |w|^2 + multiplier (|q|^2 - |p|^2) < 0 always; inf if not below ``best``."""
    root = float(np.sqrt(multiplier))
    output = np.concatenate([c.C, root * c.of_state], axis=1)
    direct = np.zeros((c.A.shape[0], output.shape[1], c.B.shape[2] + c.M.shape[2]))
    direct[:, c.C.shape[1] :, : c.B.shape[2]] = root * c.of_disturbance

    def feasible(gamma: float) -> bool:
        enter = np.concatenate([c.B, c.M * gamma / root], axis=2)
        return solve_bounded_real((c.A, enter, output, direct, c.transition), gamma**2) is not None

    low, high = 0.0, best if np.isfinite(best) else float(np.abs(c.C).max())
    most = min(best, 2.0**60 * high)
    while not feasible(high):
        low, high = high, 2.0 * high
        if not high < most:
            return np.inf
    step = TOLERANCE * best  # a search ends by bounds that hardly fall
    while high - step > low and feasible(high - step):
        high, step = high - step, 4.0 * step
    low = max(low, high - step)
    while high - low > TOLERANCE * high:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if feasible(middle) else (middle, high)
    return high


def _search(low: float, bound: Callable[[float, float], float]) -> tuple[float, float]:
    """(multiplier, bound) at the smallest bound, by golden section over the exponents.

    P, lambda and squared bounds that are proved are a convex set: over lambda the least bound falls, then rises, and below some
    lambda none is proved.
    """
    high, share = low + DECADES, (5.0**0.5 - 1.0) / 2.0
    left, right = high - share * DECADES, low + share * DECADES
    at_left, at_right = bound(left, np.inf), bound(right, np.inf)
    while high - low > NEAR:
        if at_left < at_right:
            high, right, at_right = right, left, at_left
            left = high - share * (high - low)
            at_left = bound(left, at_right)  # what is no better than the best so far need not be exact
        else:
            low, left, at_left = left, right, at_right
            right = low + share * (high - low)
            at_right = bound(right, at_left)
    at, best = min(((left, at_left), (right, at_right)), key=lambda each: each[1])
    if not np.isfinite(best):
        raise Infeasible("uncertainty: no multiplier proves a bound", value=best)
    return 10.0**at, best
