"""Whether a coupler over a delay is passive for any passive hand and any passive wall: the condition, decided in whole numbers.

    (z - 1)/(T z) C(z) - (1 - z^-(nd+1))/(2 (b + b_h))   positive real                              (*)

Why. Let w_k = (x_{k+1} - x_k)/T be the mean speed over a sample in which the force u_k is held. A passive hand, linear or not,
and a damper of at least b + b_h =: beta give sum u w >= beta sum w^2, so S: u -> u - 2 beta w is a contraction. With N = nd + 1
(the backward difference costs one sample) the delayed device is z^-N w = (z^-N u - z^-N S u)/(2 beta), and

    z^-N w + (1 - z^-N)/(2 beta) u = (u - z^-N S u)/(2 beta)

is passive. What is left for the coupler is (*). With nd = 0 this is (6.9) of Theorem 6.1; (6.9) forgets the delay.

On the circle, for C(z) = sum c_l z^-l, the real part of (*) divided by 1 - cos t is a cosine polynomial: Dirichlet's kernels D_l
and Fejer's F_N,

    (1/T) sum_l c_l D_l(t) - F_N(t)/(2 beta),   D_l = 1 + 2 sum_{j<=l} cos jt,   F_N = N + 2 sum_{j<N} (N - j) cos jt,

The condition asks whether it is nonnegative, which `is_nonnegative` decides. C has no pole outside 0 (an integrator adds d/T to
the real part).

Reference: Chapter 6, Theorem 6.1 and what replaces it (ERRATA 22).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from fractions import Fraction
from itertools import pairwise, zip_longest
from typing import NamedTuple

import numpy as np

from design.controllers.rendered_wall import Coupler
from design.passivity import Array

SHORT_BITS = 36  # a first try with short numbers; where it proves nothing, the numbers as given decide

Integers = list[int]  # coefficients of an integer polynomial, lowest power first, no zero at the end; [] is zero


def is_nonnegative(coefficients: Sequence[Fraction]) -> bool:
    """Return whether a_0 + a_1 cos t + ... + a_n cos nt >= 0 for every t.

    All frequencies are decided, in integers:

        p(t) = a_0 + a_1 cos t + ... + a_n cos nt = P(x),  x = cos t in [-1, 1],  cos jt = T_j(x)

    P is nonnegative on [-1, 1] exactly if it is so at one point that is no root, and no root of odd multiplicity lies inside.
    Roots of odd multiplicity are what Yun's decomposition leaves of P; Sturm's theorem counts them. There is no grid, no solver
    and no rounding: the answer is a proof, either way.

    References: Yun, On square-free decomposition algorithms, 1976; Basu, Pollack, Roy, Algorithms in Real Algebraic Geometry,
    chapter 2.

    Args:
        coefficients: a_0, a_1, ..., exact.

    >>> is_nonnegative([Fraction(1), Fraction(-1)]), is_nonnegative([Fraction(1), Fraction(-11, 10)])
    (True, False)
    """
    return _decide(_below(coefficients)) or _decide(coefficients)


def _below(a: Sequence[Fraction]) -> list[Fraction]:
    """A polynomial of short coefficients that lies below at all frequencies: rounded, and lowered by all the rounding."""
    step = Fraction(math.ceil(max((abs(c) for c in a), default=Fraction(1))) or 1, 1 << SHORT_BITS)
    short = [round(c / step) * step for c in a]
    lost = sum((abs(c - s) for c, s in zip(a, short)), Fraction(0))
    if short:
        short[0] -= math.ceil(lost / step) * step
    return short


def _decide(coefficients: Sequence[Fraction]) -> bool:
    p = _primitive(_from_chebyshev(coefficients))
    if not p:
        return True
    for root in (1, -1):  # both edges of [-1, 1] may be roots: divided out, with the sign that x -+ 1 has inside
        while p and _at(p, root) == 0:
            p = _divided(p, [-root, 1])
            if root == 1:
                p = [-c for c in p]
    if _at(p, 1) < 0:
        return False
    chain = _chain(p, _derivative(p))
    if len(chain[-1]) > 1:  # multiple roots: p changes sign only at those of odd multiplicity
        odd = _odd_part(p, chain[-1])
        chain = _chain(odd, _derivative(odd))
    return _changes(chain, -1) == _changes(chain, 1)  # no root in (-1, 1), Sturm


def _from_chebyshev(a: Sequence[Fraction]) -> Integers:
    """Power coefficients of sum a_j T_j, multiplied by the common denominator."""
    common = math.lcm(*(c.denominator for c in a)) if a else 1
    total, before, now = [0] * len(a), [0, 1], [1]  # T_-1 = T_1
    for c in a:
        for i, r in enumerate(now):
            total[i] += int(c * common) * r
        before, now = now, [2 * n - b for n, b in zip_longest([0, *now], before, fillvalue=0)]
    return _trimmed(total)


def _trimmed(p: Integers) -> Integers:
    while p and p[-1] == 0:
        p.pop()
    return p


def _primitive(p: Integers) -> Integers:
    content = math.gcd(*p) if p else 1
    return [c // content for c in p] if content > 1 else p


def _at(p: Integers, x: int) -> int:
    return sum(c * x**i for i, c in enumerate(p))


def _derivative(p: Integers) -> Integers:
    return [i * c for i, c in enumerate(p)][1:]


def _divided(p: Integers, q: Integers) -> Integers:
    """The exact quotient of primitive polynomials (Gauss: it has whole coefficients)."""
    rest, out = list(p), [0] * (len(p) - len(q) + 1)
    for i in reversed(range(len(out))):
        out[i] = rest[i + len(q) - 1] // q[-1]
        for j, c in enumerate(q):
            rest[i + j] -= out[i] * c
    if any(rest):
        raise ArithmeticError("polynomials: the division leaves a rest")
    return out


def _negative_rest(p: Integers, q: Integers) -> Integers:
    """-(p mod q) times a positive number, without a common factor."""
    rest, lead = list(p), q[-1]
    size, sign = abs(lead), 1 if lead > 0 else -1
    while len(rest) >= len(q):
        factor, at = rest[-1] * sign, len(rest) - len(q)
        rest = [size * c for c in rest]
        for j, c in enumerate(q):
            rest[at + j] -= factor * c
        _trimmed(rest)
    return _primitive([-c for c in rest])


def _chain(p: Integers, q: Integers) -> list[Integers]:
    """Sturm's chain p, q, -(p mod q), ... up to the greatest common divisor."""
    chain = [p, _primitive(q)]
    while len(chain[-1]) > 1:
        rest = _negative_rest(chain[-2], chain[-1])
        if not rest:
            break
        chain.append(rest)
    return [c for c in chain if c]


def _odd_part(p: Integers, common: Integers) -> Integers:
    """The product of the factors of odd multiplicity, from the greatest common divisor of p and its derivative."""
    odd, multiplicity = [1], 1
    square_free = _divided(p, common)
    while len(square_free) > 1:
        shared = _chain(square_free, common)[-1] if len(common) > 1 else [1]
        shared = [1] if len(shared) == 1 else shared
        factor = _divided(square_free, shared)
        if multiplicity % 2:
            odd = _primitive(_product(odd, factor))
        square_free, common = shared, _primitive(_divided(common, shared))
        multiplicity += 1
    return odd


def _product(p: Integers, q: Integers) -> Integers:
    shifted = ([0] * i + [a * b for b in q] + [0] * (len(p) - 1 - i) for i, a in enumerate(p))
    return [sum(column) for column in zip(*shifted)]


def _changes(chain: Sequence[Integers], x: int) -> int:
    """How often the sign changes along a chain at x, zeros left out."""
    signs = [v > 0 for v in (_at(c, x) for c in chain) if v != 0]
    return sum(a != b for a, b in pairwise(signs))


def cosine_coefficients(coupler: Coupler, period_s: float | Fraction, damping_n_s_per_m: float, *delays: int) -> list[Fraction]:
    """Return the exact cosine coefficients of the real part of (*) divided by 1 - cos t, times 2 beta.

    Of several delays it is the sum of their F_N that is taken away: see `design.passivity.certificate`.

    With an integrator they are those of the real part itself, times 2 beta.

    Args:
        coupler: C.
        period_s: T in s.
        damping_n_s_per_m: beta = b + b_h in N s/m.
        delays: nd, samples; one for a delay that stays.
    """
    scale = 2 * Fraction(damping_n_s_per_m) / Fraction(period_s)
    taps = [scale * Fraction(c) for c in coupler.taps_m_per_n]
    orders = [delay + 1 for delay in delays]
    out = [Fraction(0)] * max(len(taps), *orders)
    above = Fraction(0)  # sum of the taps from the j-th on
    for j in reversed(range(len(out))):
        above += taps[j] if j < len(taps) else 0
        out[j] = (1 if j == 0 else 2) * (above - sum(max(order - j, 0) for order in orders))
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


def is_passive_over(coupler: Coupler, period_s: float | Fraction, damping_n_s_per_m: float, *delays: int) -> bool:
    """Return whether (*) holds for one delay, or for the delays that one that varies can take: decided exactly.

    Args:
        coupler: C.
        period_s: T in s.
        damping_n_s_per_m: beta in N s/m; 0 or less meets no condition.
        delays: nd, samples; several: those of `certificate.lags`.
    """
    if damping_n_s_per_m <= 0.0:
        return False
    return is_nonnegative(cosine_coefficients(coupler, period_s, damping_n_s_per_m, *delays))


class DampingNeeded(NamedTuple):
    """The damping in N s/m that (*) asks for, the delay in samples and the angle in rad per sample that ask for it."""

    damping_n_s_per_m: float
    delay: int
    angle_rad: float


def damping_needed(coupler: Coupler, period_s: float, delays: Iterable[int], *, varying: bool = False) -> DampingNeeded:
    """Return the smallest b + b_h with which a coupler meets (*) for every delay, in floats; inf where none does.

    beta = max over delays and angles of F_N(t) / (2/T sum c_l D_l(t)): the number that decides, beside the exact answer.

    Args:
        coupler: C; its integrator, which only helps, is left out.
        period_s: T in s.
        delays: the delays nd in samples.
        varying: whether they are those of `certificate.lags`, whose F_N add up; the delay returned is then the largest.
    """
    taps, asked = np.asarray(coupler.taps_m_per_n), sorted(delays) if varying else sorted(set(delays))
    t = np.linspace(0.0, np.pi, 64 * max(taps.size, asked[-1] + 1) + 1)
    worst, unit = DampingNeeded(0.0, asked[0], 0.0), (2.0 / period_s) * float(np.abs(taps).sum())
    for _ in range(3):
        offered = (2.0 / period_s) * of_taps(taps, t)
        kernels = {delay: fejer(delay + 1, t) for delay in asked}
        if varying:
            kernels = {asked[-1]: np.sum([kernels[delay] for delay in asked], axis=0)}
        for delay, kernel in kernels.items():
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


def of_taps(taps: Array, t: Array) -> Array:
    """Return sum c_l D_l(t), by Clenshaw's recurrence: one cosine for all taps.

    Args:
        taps: c_l.
        t: angles in rad per sample.
    """
    twice, found, after = 2.0 * np.cos(t), np.zeros(t.shape), np.zeros(t.shape)
    for tap in taps[::-1].tolist():
        found, after = tap + twice * found - after, found
    return found + after


def fejer(order: int, t: Array) -> Array:
    """Return F_N(t) = (1 - cos N t)/(1 - cos t) = (sin(N t/2)/sin(t/2))^2."""
    s = np.sin(t / 2.0)
    small = np.abs(s) < 1e-9
    return np.asarray(np.where(small, float(order), np.sin(order * t / 2.0) / np.where(small, 1.0, s)) ** 2)
