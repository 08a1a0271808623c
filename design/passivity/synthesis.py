r"""The stiffest coupler for a set of delays: least static compliance under the condition of every delay.

    minimise C(1) = sum c_l   subject to   (1/T) sum_l c_l D_l(t) >= max_N F_N(t)/(2 beta)   for all t

In units of T/(2 beta) neither period nor damping occurs: s_l = 2 beta c_l/T depends on the delays alone. It is a linear program
with one row for every angle. It is solved over finitely many angles, to which the angles of the worst violations are added; the
last, tiny violation is repaired by c_0, whose kernel D_0 is 1. What comes out is proved at all frequencies, in integers
(`design.passivity.condition`), so neither the grid nor the solver is part of the proof.

Integrating the rows over (0, pi) bounds every causal coupler, of any length, from below:
C(1) >= (T/pi) int max_N F_N(t)/(2 beta) dt.

A delay that varies asks for the sum of the F_N of `design.passivity.certificate`. With a weight W the program
minimises the largest |W(z) C(z)| on the circle instead: what the device moves by more than the wall, 1/Q - 1/G = C. A modulus is
the largest of Re(e^-ip W C) over all p: the p of the last answer is added as a row, until none is violated.

Reference: Theorem 6.1; ERRATA 22; (6.12), whose weight W is this one.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from msgspec import Struct

from design.controllers.rendered_wall import MAX_TAPS, Coupler
from design.errors import DesignError, FieldError, Infeasible
from design.passivity.condition import dirichlet, fejer, is_passive_over, of_taps

MARGIN = 1e-6  # of the smallest value on the circle, in units of T/(2 beta)
ROUNDS = 12
WEIGHTED_ROUNDS = 60
WEIGHT_SLACK = 1e-4  # of the largest |W C| on the grid


class CouplerDesign(Struct, frozen=True, kw_only=True):
    """The stiffest coupler that was found, and how far it is from what is possible.

    Args:
        coupler: the taps.
        delays: the delays in samples, every one of which meets the condition, exactly.
        period_s: T in s; damping_n_s_per_m: b + b_h that the condition counts on.
        bound_m_per_n: no causal coupler that meets the condition for these delays has a smaller C(1), in m/N.
    """

    coupler: Coupler
    delays: tuple[int, ...]
    period_s: float
    damping_n_s_per_m: float
    bound_m_per_n: float

    @property
    def stiffness_n_per_m(self) -> float:
        """1/C(1) in N/m: what the coupler leaves of a rigid wall."""
        return 1.0 / self.coupler.static_compliance_m_per_n


def unit_m_per_n(period_s: float, damping_n_s_per_m: float) -> float:
    """Return T/(2 b) in m/N, in units of which a coupler depends on the delays alone.

    Args:
        period_s: T in s.
        damping_n_s_per_m: b + b_h in N s/m.

    Raises:
        DesignError: one of them is not finite or not above 0.
    """
    for name, given in (("period_s", period_s), ("damping_n_s_per_m", damping_n_s_per_m)):
        if not (np.isfinite(given) and given > 0.0):
            raise DesignError(f"{name}: {given!r}, expected a finite number above 0", value=given)
    return period_s / (2.0 * damping_n_s_per_m)


def ceiling_n_per_m(period_s: float, damping_n_s_per_m: float, delay: int) -> float:
    """Return 2 b/((nd + 1) T), the static stiffness in N/m that no rendering exceeds which is safe for every passive hand.

    Args:
        period_s: T in s.
        damping_n_s_per_m: damping of the device and least damping of the hand, N s/m.
        delay: nd, samples.
    """
    return 2.0 * damping_n_s_per_m / ((delay + 1) * period_s)


def stiffest_coupler(
    delays: Iterable[int],
    *,
    period_s: float,
    damping_n_s_per_m: float,
    taps: int | None = None,
    stiffness_n_per_m: float | None = None,
    varying: bool = False,
    weight: Weight | None = None,
) -> CouplerDesign:
    """Return the coupler of least static compliance that meets the condition for every delay of a set.

    Args:
        delays: nd in samples, at least one, each at least 0.
        period_s: T in s, above 0.
        damping_n_s_per_m: damping of the device and least damping of the hand in N s/m, above 0.
        taps: length of C; by default 2 nd + 8 for the largest delay, at least 24.
        stiffness_n_per_m: a request in N/m; the design is refused if it cannot be reached.
        varying: whether they are the delays of one that varies from sample to sample, of `certificate.lags`.
        weight: W, whose largest |W C| is to be least, instead of C(1).

    Raises:
        Infeasible: the request is above the ceiling 2 b/((nd + 1) T), or above what the set of delays allows; ``value`` is
            the stiffness that can be reached.
        DesignError: an argument out of range.
    """
    asked = tuple(sorted(delays)) if varying else tuple(sorted(set(delays)))
    if not asked or asked[0] < 0:
        raise DesignError(f"delays: {list(asked)}, expected at least one, each at least 0")
    unit = unit_m_per_n(period_s, damping_n_s_per_m)
    count = max(24, 2 * asked[-1] + 8) if taps is None else taps
    if not asked[-1] + 1 <= count <= MAX_TAPS:
        raise DesignError(f"taps: {count}, expected {asked[-1] + 1} (largest delay + 1) to {MAX_TAPS}", value=count)
    ceiling = ceiling_n_per_m(period_s, damping_n_s_per_m, asked[-1])
    if stiffness_n_per_m is not None and stiffness_n_per_m > ceiling:
        raise Infeasible(
            f"stiffness_n_per_m: {stiffness_n_per_m:.6g} N/m is above the ceiling 2 b/((nd + 1) T) = {ceiling:.6g} N/m "
            f"(b = {damping_n_s_per_m:.6g} N s/m, nd = {asked[-1]}, T = {period_s:.6g} s), which nothing exceeds that is "
            "safe for every passive hand; more damping, a shorter period or a shorter delay raise it",
            value=ceiling,
        )
    shape = _shape(_Asked(asked, count, varying, weight))
    coupler = Coupler(taps_m_per_n=tuple((unit * shape).tolist()))
    for each in [asked] if varying else [(delay,) for delay in asked]:
        if not is_passive_over(coupler, period_s, damping_n_s_per_m, *each):
            raise DesignError(f"coupler: the taps found do not meet the condition for a delay of {each[-1]} samples")
    found = CouplerDesign(
        coupler=coupler,
        delays=asked,
        period_s=period_s,
        damping_n_s_per_m=damping_n_s_per_m,
        bound_m_per_n=unit * least_sum(asked, varying=varying),
    )
    if stiffness_n_per_m is not None and stiffness_n_per_m > found.stiffness_n_per_m:
        raise Infeasible(
            f"stiffness_n_per_m: {stiffness_n_per_m:.6g} N/m; one coupler of {count} taps that is safe for every delay of "
            f"{list(asked)} reaches {found.stiffness_n_per_m:.6g} N/m, and none exceeds {1.0 / found.bound_m_per_n:.6g} N/m",
            value=found.stiffness_n_per_m,
        )
    return found


class _Asked(NamedTuple):
    delays: tuple[int, ...]
    taps: int
    varying: bool
    weight: Weight | None

    def needed(self, t: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
        kernels = np.array([fejer(delay + 1, t) for delay in self.delays])
        return np.asarray(kernels.sum(axis=0) if self.varying else kernels.max(axis=0))


@lru_cache(maxsize=64)
def _shape(asked: _Asked) -> npt.NDArray[np.float64]:
    """Taps in units of T/(2 beta), with a margin at all frequencies."""
    fine = np.asarray(np.linspace(0.0, np.pi, 256 * asked.taps + 1), dtype=np.float64)
    kernels, wanted = dirichlet(asked.taps, fine), asked.needed(fine)
    angles = np.arange(0, fine.size, 32)
    weighed = None if asked.weight is None else asked.weight.of_taps(asked.taps, fine[::16])
    cuts = None if weighed is None else weighed[:, :1].real.T  # Re(e^-ip W C) <= g, a row each
    shape, gap = np.zeros(asked.taps), wanted
    for _ in range(ROUNDS if weighed is None else WEIGHTED_ROUNDS):
        shape = _least(-kernels[:, angles].T, -wanted[angles], cuts)
        gap = wanted - shape @ kernels
        inner = gap[1:-1]
        peaks = 1 + np.flatnonzero((inner >= gap[:-2]) & (inner > gap[2:]) & (inner > 1e-9))
        more = np.zeros((0, asked.taps)) if weighed is None else _violated(weighed, shape, cuts)
        if not np.setdiff1d(peaks, angles).size and not len(more):
            break
        angles = np.union1d(angles, peaks)
        cuts = None if cuts is None else np.vstack([cuts, more])
    near = 1 + np.flatnonzero((gap[1:-1] >= gap[:-2]) & (gap[1:-1] > gap[2:]) & (gap[1:-1] > -1e-3 * shape.sum()))
    pieces = [np.linspace(fine[i - 1], fine[i + 1], 129) for i in near]
    between = np.asarray(np.concatenate([np.array([0.0, np.pi]), *pieces]), dtype=np.float64)
    short = float((asked.needed(between) - of_taps(shape, between)).max())
    shape[0] += max(short, 0.0) + MARGIN * float(shape.sum())
    return shape


def _least(rows: npt.NDArray[Any], right: npt.NDArray[Any], cuts: npt.NDArray[Any] | None) -> npt.NDArray[np.float64]:
    """Minimise the sum of the taps, or g over the rows cuts s <= g, subject to rows s <= right."""
    from scipy.optimize import linprog

    count = rows.shape[1]
    cost = np.ones(count)
    if cuts is not None:
        rows = np.vstack([np.hstack([rows, np.zeros((len(rows), 1))]), np.hstack([cuts, -np.ones((len(cuts), 1))])])
        right, cost = np.concatenate([right, np.zeros(len(cuts))]), np.append(np.zeros(count), 1.0)
    result: Any = linprog(cost, A_ub=rows, b_ub=right, bounds=[(None, None)] * len(cost), method="highs-ds")
    if result.x is None:
        raise DesignError(f"coupler: the linear program ended without an answer ({result.message})")
    return np.asarray(result.x)[:count]


def _violated(
    weighed: npt.NDArray[Any], shape: npt.NDArray[np.float64], cuts: npt.NDArray[Any] | None
) -> npt.NDArray[np.float64]:
    """Return the rows Re(e^-ip W C) of the angles where |W C| has a peak above the largest that the rows so far admit."""
    response = shape @ weighed
    size, level = np.abs(response), float((cuts @ shape).max()) if cuts is not None else 0.0
    padded = np.concatenate([[-1.0], size, [-1.0]])
    peak = (padded[1:-1] >= padded[:-2]) & (padded[1:-1] >= padded[2:]) & (size > (1.0 + WEIGHT_SLACK) * level)
    return np.asarray((weighed[:, peak] * (response[peak].conj() / size[peak])).real.T)


def least_sum(delays: Iterable[int], *, varying: bool = False) -> float:
    """Return (1/pi) int_0^pi max_N F_N(t) dt: a lower bound of C(1) in units of T/(2 beta), by the midpoint rule.

    For a delay that varies it is that of the sum, which is the sum of all N.
    """
    if varying:
        return float(sum(delay + 1 for delay in delays))
    asked = sorted(set(delays))
    count = 4096 * (asked[-1] + 1)
    t = np.asarray((np.arange(count) + 0.5) * (np.pi / count), dtype=np.float64)
    largest = fejer(asked[0] + 1, t)
    for delay in asked[1:]:
        largest = np.maximum(largest, fejer(delay + 1, t))
    return float(largest.mean())


class Weight(Struct, frozen=True):
    """A weight of a user's own, W(z) = (b_0 + b_1 z^-1 + ...)/(a_0 + a_1 z^-1 + ...), stable: where a coupler is to be stiff.

    Raises:
        FieldError: no coefficient, one that is not finite, a zero first one below, or a pole on or outside the circle.
    """

    numerator: tuple[float, ...]
    denominator: tuple[float, ...] = (1.0,)

    def __post_init__(self) -> None:
        for name, given in (("numerator", self.numerator), ("denominator", self.denominator)):
            if not given or not np.isfinite(given).all() or not any(given):
                raise FieldError(name, f"{list(given)}, expected finite coefficients of z^0, z^-1, ..., not all zero")
        poles = np.abs(np.roots(self.denominator)) if self.denominator[0] else np.array([np.inf])
        if poles.size and poles.max() >= 1.0:
            raise FieldError("denominator", f"{list(self.denominator)} has a pole of modulus {poles.max():.6g}, expected below 1")

    def at(self, t: npt.NDArray[np.float64]) -> npt.NDArray[np.complex128]:
        """Return W(e^it).

        Args:
            t: angles in rad per sample.
        """
        z = np.exp(-1j * t)
        over, under = (np.polyval(c[::-1], z) for c in (self.numerator, self.denominator))
        return np.asarray(over / under, dtype=np.complex128)

    def of_taps(self, count: int, t: npt.NDArray[np.float64]) -> npt.NDArray[np.complex128]:
        """Return W(e^it) e^-ilt for l = 0 .. count - 1 as rows: what each tap adds to W C.

        Args:
            count: number of taps.
            t: angles in rad per sample.
        """
        return np.asarray(self.at(t) * np.exp(-1j * np.outer(np.arange(count), t)))

    def peak(self, coupler: Coupler) -> float:
        """Return the largest |W(z) C(z)| on the circle, in m/N.

        Args:
            coupler: C, without an integrator.
        """
        t = np.linspace(0.0, np.pi, 256 * len(coupler.taps_m_per_n) + 1)
        return float(np.abs(self.at(t) * np.polyval(coupler.taps_m_per_n[::-1], np.exp(-1j * t))).max())
