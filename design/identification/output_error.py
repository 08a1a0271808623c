"""Gain and pole of an axis from records, by output error: a state-variable filter to start, Gauss-Newton to finish.

    min over (g, p, y_0, v_0)  sum_k (y(k) - y_0 - v_0 phi_v(k; p) - g phi_u(k; p))^2

For noise on the measured output this is maximum likelihood, also where that output is fed back, as the input is known.

Reference: thesis sec. 6.2.1; Ljung, System Identification, 1999, sec. 7.4, 9.4.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from design.errors import DesignError
from design.identification.axis import Array, forced, free
from design.identification.excitation import covariance, sensitivities
from design.identification.least_squares import plain_least_squares
from design.identification.record import Record
from design.identification.residual_test import ResidualTest, residual_test
from design.identification.state_variable_filter import state_variable_filter

LEVEL = 0.95
MOST_STEPS = 60
CUTOFFS = 5


@dataclass(frozen=True, slots=True, kw_only=True)
class Interval:
    """A number with its confidence interval.

    Args:
        value: the estimate.
        error: its standard error.
        low, high: ends of the 95 % interval.
    """

    value: float
    error: float
    low: float
    high: float

    def covers(self, truth: float) -> bool:
        """Return whether a number lies within."""
        return self.low <= truth <= self.high


@dataclass(frozen=True, slots=True, kw_only=True)
class AxisFit:
    """What records tell of an axis y'' + p y' = g u.

    Args:
        gain, pole: g and p.
        inertia, damping: m = 1/g and b = p/g, of the same fit.
        noise_sd: standard deviation of the residuals, in the output's unit.
        samples: measured outputs that were fitted.
        plain: g and p by plain least squares, None where it gives none.
        start: g and p that the fit began with.
        residuals: whether what is left is noise.
        starts: y_0 and v_0 of every record.
    """

    gain: Interval
    pole: Interval
    inertia: Interval
    damping: Interval
    noise_sd: float
    samples: int
    plain: tuple[float, float] | None
    start: tuple[float, float]
    residuals: ResidualTest
    starts: tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True)
class _Point:
    """The best fit for one p."""

    pole: float
    gain: float
    starts: tuple[tuple[float, float], ...]
    left: Array  # residuals
    cost: float


def identify_axis(records: Sequence[Record]) -> AxisFit:
    """Return gain and pole, inertia and damping, with intervals and the test of what is left.

    Args:
        records: at least one, of one axis and one sample period; each has its own initial position and speed.

    Raises:
        DesignError: no records, several periods, an input that does not move the axis, or an output that does not follow it.
    """
    if not records:
        raise DesignError("records: none, expected at least one")
    periods = sorted({r.period_s for r in records})
    if len(periods) > 1:
        raise DesignError(f"records: sample periods from {periods[0]:g} to {periods[-1]:g} s, expected one")
    plain = plain_least_squares(records)
    start = _start(records, plain)
    best = _descend(records, _project(records, start[1]))
    jacobian = sensitivities(records, best.gain, best.pole, best.starts)
    unit = covariance(jacobian)
    samples, count = jacobian.shape
    freedom = samples - count
    variance = best.cost / freedom
    width = float(student.ppf(0.5 + 0.5 * LEVEL, freedom))
    size = float(np.concatenate([r.y[r.measured] - np.nanmean(r.y) for r in records]).std())
    if not best.gain > width * math.sqrt(variance * unit[0, 0]):
        raise DesignError(
            f"output: does not follow the input (gain {best.gain:.3g} with a standard error of "
            f"{math.sqrt(variance * unit[0, 0]):.3g}); does the axis move, and have both columns the right sign?"
        )
    g, p = best.gain, best.pole

    def interval(value: float, by_gain: float, by_pole: float) -> Interval:
        slope = np.array([by_gain, by_pole])
        error = math.sqrt(max(variance * float(slope @ unit[:2, :2] @ slope), 0.0))
        return Interval(value=value, error=error, low=value - width * error, high=value + width * error)

    return AxisFit(
        gain=interval(g, 1.0, 0.0), pole=interval(p, 0.0, 1.0), inertia=interval(1.0 / g, -1.0 / g**2, 0.0),
        damping=interval(p / g, -p / g**2, 1.0 / g), noise_sd=math.sqrt(variance), samples=samples, plain=plain, start=start,
        residuals=residual_test(best.left, size), starts=best.starts,
    )  # fmt: skip


def _start(records: Sequence[Record], plain: tuple[float, float] | None) -> tuple[float, float]:
    """Return the start that fits best, of state-variable filters over the band of the records, and plain least squares."""
    period_s, length_s = records[0].period_s, max(r.u.size * r.period_s for r in records)
    cutoffs = np.geomspace(20.0 / length_s, 0.4 / period_s, CUTOFFS)
    found = [state_variable_filter(records, float(c)) for c in cutoffs]
    starts = [s for s in (*found, plain) if s is not None] or [(1.0, 1.0)]
    return min(starts, key=lambda s: _cost(records, s[1]))


def _cost(records: Sequence[Record], pole: float) -> float:
    if pole * max(r.u.size * r.period_s for r in records) < -50.0:
        return math.inf  # would leave every float
    return _project(records, pole).cost


def _project(records: Sequence[Record], pole: float) -> _Point:
    """Return the best g, y_0 and v_0 for a p: a linear problem."""
    count, rows, outputs = len(records), [], []
    for i, record in enumerate(records):
        kept = record.measured
        block = np.zeros((int(kept.sum()), 1 + 2 * count))
        block[:, 0] = forced(record.u, pole, record.period_s)[0][kept]
        block[:, 1 + 2 * i] = 1.0
        block[:, 2 + 2 * i] = free(record.u.size, pole, record.period_s)[0][kept]
        rows.append(block)
        outputs.append(record.y[kept])
    matrix, y = np.vstack(rows), np.concatenate(outputs)
    scale = np.maximum(np.linalg.norm(matrix, axis=0), 1e-300)
    found = np.linalg.lstsq(matrix / scale, y, rcond=None)[0] / scale
    left = y - matrix @ found
    starts = tuple((float(found[1 + 2 * i]), float(found[2 + 2 * i])) for i in range(count))
    return _Point(pole, float(found[0]), starts, left, float(left @ left))


def _descend(records: Sequence[Record], at: _Point) -> _Point:
    """Return where Gauss-Newton steps in p, with the rest solved for, no longer help."""
    for _ in range(MOST_STEPS):
        jacobian = sensitivities(records, at.gain, at.pole, at.starts)
        scale = np.maximum(np.linalg.norm(jacobian, axis=0), 1e-300)
        step = float((np.linalg.lstsq(jacobian / scale, at.left, rcond=None)[0] / scale)[1])
        share = 1.0
        while True:
            if _cost(records, at.pole + share * step) < at.cost:
                break
            share *= 0.5
            if share < 1e-4:
                return at
        at = _project(records, at.pole + share * step)
        if abs(share * step) <= 1e-11 * max(abs(at.pole), 1e-3):
            return at
    return at
