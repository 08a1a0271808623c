r"""The condition for a coupler over a delay: passive for any passive hand and any passive wall.

    (z - 1)/(T z) C(z) - (1 - z^-(nd+1))/(2 (b + b_h))   positive real                              (*)

Why. Let w_k = (x_{k+1} - x_k)/T be the mean speed over a sample in which the force u_k is held. A passive hand, linear or not,
and a damper of at least b + b_h =: beta give sum u w >= beta sum w^2, so S: u -> u - 2 beta w is a contraction. With N = nd + 1
(the backward difference costs one sample) the delayed device is z^-N w = (z^-N u - z^-N S u)/(2 beta), and

    z^-N w + (1 - z^-N)/(2 beta) u = (u - z^-N S u)/(2 beta)

is passive. What is left for the coupler is (*). With nd = 0 this is (6.9) of Theorem 6.1; (6.9) forgets the delay.

On the circle, for C(z) = sum c_l z^-l, the real part of (*) divided by 1 - cos t is a cosine polynomial: Dirichlet's kernels D_l
and Fejer's F_N,

    (1/T) sum_l c_l D_l(t) - F_N(t)/(2 beta),   D_l = 1 + 2 sum_{j<=l} cos jt,   F_N = N + 2 sum_{j<N} (N - j) cos jt,

which `design.passivity.cosine` decides in whole numbers. C has no pole outside 0 (an integrator adds d/T to the real part).

Reference: Chapter 6, Theorem 6.1 and what replaces it (ERRATA 22).
"""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from design.controllers.coupler import Coupler
from design.passivity.cosine import is_nonnegative

Array = npt.NDArray[np.float64]


def cosine_coefficients(
    coupler: Coupler, period_s: float | Fraction, damping_n_s_per_m: float, delay: int
) -> list[Fraction]:
    """Return the exact cosine coefficients of the real part of (*) divided by 1 - cos t, times 2 beta.

    With an integrator they are those of the real part itself, times 2 beta.

    Args:
        coupler: C.
        period_s: T in s.
        damping_n_s_per_m: beta = b + b_h in N s/m.
        delay: nd, samples.
    """
    scale = 2 * Fraction(damping_n_s_per_m) / Fraction(period_s)
    taps = [scale * Fraction(c) for c in coupler.taps_m_per_n]
    order = delay + 1
    out = [Fraction(0)] * max(len(taps), order)
    above = Fraction(0)  # sum of the taps from the j-th on
    for j in reversed(range(len(out))):
        above += taps[j] if j < len(taps) else 0
        out[j] = (above if j == 0 else 2 * above) - (max(order - j, 0) if j == 0 else 2 * max(order - j, 0))
    if not coupler.integrator_m_per_n:
        return out
    whole = [Fraction(0)] * (len(out) + 1)  # times 1 - cos t: cos t cos jt = (cos (j+1)t + cos (j-1)t)/2
    for j, a in enumerate(out):
        whole[j] += a
        whole[j + 1] -= a / 2 if j else a
        if j:
            whole[j - 1] -= a / 2
    whole[0] += scale * Fraction(coupler.integrator_m_per_n)
    return whole


def is_passive_over(coupler: Coupler, period_s: float | Fraction, damping_n_s_per_m: float, delay: int) -> bool:
    """Return whether (*) holds for one delay, decided exactly for the numbers as given.

    Args:
        coupler: C.
        period_s: T in s.
        damping_n_s_per_m: beta in N s/m; 0 or less meets no condition.
        delay: nd, samples.
    """
    if damping_n_s_per_m <= 0.0:
        return False
    return is_nonnegative(cosine_coefficients(coupler, period_s, damping_n_s_per_m, delay))


class DampingNeeded(NamedTuple):
    """The damping in N s/m that (*) asks for, the delay in samples and the angle in rad per sample that ask for it."""

    damping_n_s_per_m: float
    delay: int
    angle_rad: float


def damping_needed(coupler: Coupler, period_s: float, delays: Iterable[int]) -> DampingNeeded:
    """Return the smallest b + b_h with which a coupler meets (*) for every delay, in floats; inf where none does.

    beta = max over delays and angles of F_N(t) / (2/T sum c_l D_l(t)): the number that decides, beside the exact answer.

    Args:
        coupler: C; its integrator, which only helps, is left out.
        period_s: T in s.
        delays: the delays nd in samples.
    """
    taps, asked = np.asarray(coupler.taps_m_per_n), sorted(set(delays))
    t = np.linspace(0.0, np.pi, 64 * max(taps.size, asked[-1] + 1) + 1)
    worst, unit = DampingNeeded(0.0, asked[0], 0.0), (2.0 / period_s) * float(np.abs(taps).sum())
    for _ in range(3):
        offered = (2.0 / period_s) * (taps @ dirichlet(taps.size, t))
        for delay in asked:
            kernel = fejer(delay + 1, t)
            touches = (np.abs(offered) <= 1e-7 * unit) & (kernel <= 1e-7)  # a common zero, as the wave coupler has
            with np.errstate(divide="ignore", invalid="ignore"):
                needs = np.where(touches, 0.0, np.where(offered > 0.0, kernel / offered, np.inf))
            i = int(needs.argmax())
            if needs[i] > worst.damping_n_s_per_m:
                worst = DampingNeeded(float(needs[i]), delay, float(t[i]))
        step = t[1] - t[0]
        t = np.clip(worst.angle_rad + np.linspace(-step, step, 129), 0.0, np.pi)
    return worst


def dirichlet(taps: int, t: Array) -> Array:
    """Return D_0(t) .. D_(taps-1)(t) as rows, D_l(t) = sin((l + 1/2) t)/sin(t/2)."""
    l, s = np.arange(taps)[:, None], np.sin(t / 2.0)
    small = np.abs(s) < 1e-9
    return np.asarray(np.where(small, 2.0 * l + 1.0, np.sin((l + 0.5) * t) / np.where(small, 1.0, s)))


def fejer(order: int, t: Array) -> Array:
    """Return F_N(t) = (1 - cos N t)/(1 - cos t) = (sin(N t/2)/sin(t/2))^2."""
    s = np.sin(t / 2.0)
    small = np.abs(s) < 1e-9
    return np.asarray(np.where(small, float(order), np.sin(order * t / 2.0) / np.where(small, 1.0, s)) ** 2)
