"""Gain and pole of an axis from records, by output error: a state-variable filter to start, Gauss-Newton to finish.

    min over (g, p, y_0, v_0)  sum_k (y(k) - y_0 - v_0 phi_v(k; p) - g phi_u(k; p))^2

For noise on the measured output this is maximum likelihood, also where that output is fed back, as the input is known.

Reference: thesis sec. 6.2.1; Ljung, System Identification, 1999, sec. 7.4, 9.4.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np
from msgspec import Struct
from scipy.special import chdtrc, stdtrit

from design.errors import DesignError
from design.identification import Array, Record, covariance, dry_friction, recursion, sensitivities


def plain_least_squares(records: Sequence[Record]) -> tuple[float, float] | None:
    """Return g and p, None where the fitted a is not between 0 and 1 or the gain not above 0.

    It is for comparison: it is biased as soon as the output carries noise.

        dy(k+1) = a dy(k) + b_1 u(k) + b_2 u(k-1),     p = -ln(a)/T,     g = (b_1 + b_2) p / (T (1 - a))

    Reference: thesis sec. 6.2.1; Ljung, System Identification, 1999, sec. 7.3.

    Args:
        records: of one sample period.
    """
    left, right = [], []
    for record in records:
        moved = np.diff(record.y)
        rows = np.column_stack([moved[:-1], record.u[1:-1], record.u[:-2]])
        kept = np.isfinite(rows).all(axis=1) & np.isfinite(moved[1:])
        left.append(rows[kept])
        right.append(moved[1:][kept])
    a, b1, b2 = (float(x) for x in np.linalg.lstsq(np.vstack(left), np.concatenate(right), rcond=None)[0])
    period_s = records[0].period_s
    if not (0.0 < a < 1.0 and b1 + b2 > 0.0):
        return None
    pole = -math.log(a) / period_s
    return (b1 + b2) * pole / (period_s * (1.0 - a)), pole


SKIPPED = 8.0
"""Time constants of the filter after which its own start no longer counts."""


def state_variable_filter(records: Sequence[Record], cutoff: float) -> tuple[float, float] | None:
    """Return g and p by least squares on filtered signals; None where too little is left or the gain is not above 0.

    It is the start of a fit: derivatives of filtered signals take the place of differences.

    With L = l^2/(s + l)^2 and y'' = -p y' + g u it holds that s^2 L y = -p (s L y) + g (L u), up to what decays with exp(-l t).

    References: Young, Parameter estimation for continuous-time models, 1981; Garnier and Wang (eds.), Identification of
    Continuous-time Models from Sampled Data, 2008, ch. 1.

    The output counts as a straight line between its samples, missing ones too; the input as held.

    Args:
        records: what was recorded.
        cutoff: l in 1/s, above the poles that matter and below 1/T.
    """
    left, right = [], []
    for record in records:
        kept = record.measured
        index = np.arange(record.y.size)
        speed = np.diff(np.interp(index, index[kept], record.y[kept]), append=0.0) / record.period_s  # the last one moves nothing
        first = int(SKIPPED / (cutoff * record.period_s)) + 1
        if speed.size - first < 10:
            continue
        slow, fast = (_filtered(speed, cutoff * record.period_s, slope) for slope in (0.0, cutoff))
        held = _filtered(record.u, cutoff * record.period_s)
        left.append(np.column_stack([-slow, held])[first:])
        right.append(fast[first:])
    if not left:
        return None
    pole, gain = (float(x) for x in np.linalg.lstsq(np.vstack(left), np.concatenate(right), rcond=None)[0])
    return (gain, pole) if gain > 0.0 and np.isfinite(pole) else None


def _filtered(held: Array, z: float, slope: float = 0.0) -> Array:
    """Return l^2/(s + l)^2 of a signal that is held over every sample, z = l T; with slope = l, s times that."""
    e = math.exp(-z)
    now, before = (slope * z * e, -slope * z * e) if slope else (1.0 - e - z * e, e * (e + z - 1.0))
    return recursion((-2.0 * e, e * e), np.convolve(held, (now, before))[: held.size])


LAGS = 20
"""Tested at most; of fewer than 1000 samples one in 50: of 100 white ones over 20 lags it would reject 4 of 100, not 1."""
RARE = 0.01
EXACT = 1e-9
"""Residuals below this share of the output are rounding, not noise."""

ResidualVerdict = Literal["white", "correlated", "exact"]


class ResidualTest(Struct, frozen=True, kw_only=True):
    """The test of one fit.

    Args:
        verdict: ``white``; ``correlated``: the model or the noise is another, the intervals are too narrow; ``exact``:
            there is no noise to be tested.
        statistic: Q.
        lags: how many.
        p_value: of Q, if the residuals are white.
    """

    verdict: ResidualVerdict
    statistic: float
    lags: int
    p_value: float


def residual_test(residuals: Array, size: float, jacobian: Array) -> ResidualTest:
    """Return the Ljung-Box test of residuals (n,), in order of time: only where they are noise do intervals mean what they say.

        Q = n (n + 2) sum_l (r_l - e_l)^2/(n - l),     chi^2 with as many degrees of freedom as lags

    The fit takes from white noise what it can follow, P of it, and leaves e_l = -sum_t P(t, t + l)/(n - parameters): of records
    that are short, each with a start of its own, more than chance does.

    Reference: Ljung and Box, On a measure of lack of fit in time series models, Biometrika 65, 1978.

    Args:
        residuals: measured minus fitted output (n,).
        size: standard deviation of the output, to know rounding from noise.
        jacobian: derivatives of the fitted outputs by the parameters (n, parameters).
    """
    n = residuals.size
    lags = min(LAGS, max(n // 50, 1))
    power = float(residuals @ residuals)
    if power <= n * (EXACT * size) ** 2:
        return ResidualTest(verdict="exact", statistic=0.0, lags=lags, p_value=1.0)
    taken = np.linalg.qr(jacobian / np.linalg.norm(jacobian, axis=0))[0]

    def lagged(signals: Array, lag: int) -> float:
        return float((signals[lag:] * signals[:-lag]).sum())

    shares = [lagged(residuals, l) / power + lagged(taken, l) / (n - taken.shape[1]) for l in range(1, lags + 1)]
    statistic = n * (n + 2) * sum(r * r / (n - lag) for lag, r in enumerate(shares, 1))
    p_value = float(chdtrc(lags, statistic))
    return ResidualTest(
        verdict="white" if p_value >= RARE else "correlated", statistic=float(statistic), lags=lags, p_value=p_value
    )


LEVEL = 0.95
MOST_STEPS = 60
CUTOFFS = 5


class Interval(Struct, frozen=True, kw_only=True):
    """A number with its confidence interval.

    Args:
        value: the estimate.
        error: its standard error.
        low, high: ends of the 95 % interval, where nothing else is said.
    """

    value: float
    error: float
    low: float
    high: float

    def covers(self, truth: float) -> bool:
        """Return whether a number lies within."""
        return self.low <= truth <= self.high


class AxisFit(Struct, frozen=True, kw_only=True):
    """What records tell of an axis y'' + p y' = g u.

    Args:
        gain, pole: g and p.
        inertia, damping: m = 1/g and b = p/g, of the same fit.
        noise_sd: standard deviation of the residuals, in the output's unit.
        samples: measured outputs that were fitted.
        plain: g and p by plain least squares, None where it gives none.
        start: g and p that the fit began with.
        residuals: whether what is left is noise.
        friction: dry friction beside the model, in the input's unit, its interval at 99 %; see `dry_friction`. The model has
            none, and what the interval leaves room for may shift the others.
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
    friction: Interval
    starts: tuple[tuple[float, float], ...]


class _Point(Struct, frozen=True):
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
    width = float(stdtrit(freedom, 0.5 + 0.5 * LEVEL))
    size = float(np.concatenate([r.y[r.measured] - np.nanmean(r.y) for r in records]).std())
    if not best.gain > width * math.sqrt(variance * unit[0, 0]):
        raise DesignError(
            f"output: does not follow the input (gain {best.gain:.3g} with a standard error of "
            f"{math.sqrt(variance * unit[0, 0]):.3g}); does the axis move, and have both columns the right sign?"
        )
    g, p = best.gain, best.pole

    ((gg, gp), (_, pp)) = (variance * unit[:2, :2]).tolist()

    def interval(value: float, error: float) -> Interval:
        return Interval(value=value, error=error, low=value - width * error, high=value + width * error)

    def over_gain(top: float, of_top: float, with_gain: float) -> Interval:
        """Fieller's interval (1954) of top / g: every r for which top - r g may be 0; it covers where g is known badly, too."""
        square, value = width * width, top / g
        a, b, c = g * g - square * gg, g * top - square * with_gain, top * top - square * of_top
        half = math.sqrt(max(b * b - a * c, 0.0)) / a
        error = math.sqrt(max(of_top - 2.0 * value * with_gain + value * value * gg, 0.0)) / g
        return Interval(value=value, error=error, low=b / a - half, high=b / a + half)

    f, error = dry_friction(records, g, p, best.starts, best.left, jacobian)
    wide = float(stdtrit(freedom - 1, 1.0 - 0.5 * RARE)) * error
    return AxisFit(
        friction=Interval(value=f, error=error, low=f - wide, high=f + wide),
        gain=interval(g, math.sqrt(gg)), pole=interval(p, math.sqrt(pp)), inertia=over_gain(1.0, 0.0, 0.0),
        damping=over_gain(p, pp, gp), noise_sd=math.sqrt(variance), samples=samples, plain=plain, start=start,
        residuals=residual_test(best.left, size, jacobian), starts=best.starts,
    )  # fmt: skip


def _start(records: Sequence[Record], plain: tuple[float, float] | None) -> tuple[float, float]:
    """Return the start that fits best, of state-variable filters over the band of the records, and plain least squares."""
    period_s, length_s = records[0].period_s, max(r.u.size * r.period_s for r in records)
    cutoffs = np.geomspace(20.0 / length_s, 0.4 / period_s, CUTOFFS)
    found = [state_variable_filter(records, float(c)) for c in cutoffs]
    starts = [s for s in (*found, plain) if s is not None] or [(1.0, 1.0)]
    best = min(starts, key=lambda s: _cost(records, s[1]))
    if not math.isfinite(_cost(records, best[1])):
        raise DesignError("output: does not follow the input as that of an axis; are its columns and its period right?")
    return best


def _cost(records: Sequence[Record], pole: float) -> float:
    if pole * max(r.u.size * r.period_s for r in records) < -50.0:
        return math.inf  # would leave every float
    return _project(records, pole).cost


def _project(records: Sequence[Record], pole: float) -> _Point:
    """Return the best g, y_0 and v_0 for a p: a linear problem, in all sensitivities but that of p."""
    matrix = np.delete(sensitivities(records, 0.0, pole, [(0.0, 0.0)] * len(records)), 1, axis=1)
    y = np.concatenate([record.y[record.measured] for record in records])
    scale = np.maximum(np.linalg.norm(matrix, axis=0), 1e-300)
    found = np.linalg.lstsq(matrix / scale, y, rcond=None)[0] / scale
    left = y - matrix @ found
    starts = tuple((float(y_0), float(v_0)) for y_0, v_0 in found[1:].reshape(-1, 2))
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
    return at
