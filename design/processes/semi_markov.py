"""Semi-Markov processes in continuous time: transition rates, reset rules, exact sampling of the next jump.

Reset rules (what restarts which clock):

- ``SemiMarkov``: every jump restarts the one sojourn clock h (Remark 2.1).
- ``FaultDetection`` (Chapter 4): a jump of the failure process eta restarts eta's clock, one of the detection process r
  restarts r's clock. Whether a jump of eta restarts r's clock too is not said in the thesis; the caller must say.

The next jump from mode i at clock reading a is drawn without time steps: with E ~ Exp(1) and U ~ U[0, 1),

    H_i(h) - H_i(a) = E,   H_i = sum_j int lambda_ij,      target j with probability lambda_ij(h) / sum_l lambda_il(h).

The inversion is closed form for piecewise linear rates and safeguarded Newton (to rounding) for all others. ``jump``
takes E and U as arguments, so that a batch engine can draw them from one stream per run.

References: thesis (2.1), (2.6)-(2.7), Section 4.2; ERRATA 5.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from design.errors import FieldError
from design.processes.rates import FloatArray, PiecewiseLinearRate, Rate, TendingRate

IntArray = npt.NDArray[np.intp]


def _sum_piecewise_linear(rates: Sequence[PiecewiseLinearRate]) -> PiecewiseLinearRate:
    """The total of piecewise linear rates, steps included, as one table."""
    nodes = sorted({0.0, *(b for rate in rates for b in rate.breaks)})
    times: list[float] = []
    values: list[float] = []
    for left, right in zip(nodes, [*nodes[1:], math.inf]):
        inside = right if math.isfinite(right) else left + 1.0
        middle = 0.5 * (left + inside)
        start = sum(float(rate(left)) for rate in rates)
        end = 2.0 * sum(float(rate(middle)) for rate in rates) - start  # limit from the left: the cell is linear
        times += [left, inside] if math.isfinite(right) else [left]
        values += [start, max(end, 0.0)] if math.isfinite(right) else [start]
    return PiecewiseLinearRate(times_s=tuple(times), values=tuple(values))


@dataclass(frozen=True, slots=True, kw_only=True)
class SemiMarkov:
    """A semi-Markov process with N modes (counted from 0) whose every jump restarts the sojourn clock.

    Args:
        rates: N rows of N entries, rates[i][j] is lambda_ij; ``None`` where no jump leads and on the diagonal.

    >>> from design.processes.rates import clip_rate
    >>> process = SemiMarkov(rates=((None, clip_rate(0.1, 4.6)), (clip_rate(0.1, 4.6), None)))
    >>> process.bounds(0, 0.0, 0.5)
    (array([0. , 0.1]), array([0. , 0.5]))
    """

    rates: tuple[tuple[Rate | None, ...], ...]
    _totals: tuple[PiecewiseLinearRate | None, ...] = field(init=False, repr=False, compare=False)
    _tables: tuple[tuple[FloatArray, FloatArray] | None, ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if not self.rates:
            raise FieldError("rates", "expected at least one mode")
        for i, row in enumerate(self.rates):
            if len(row) != len(self.rates):
                raise FieldError(f"rates[{i}]", f"{len(row)} entries, expected {len(self.rates)}")
            if row[i] is not None:
                raise FieldError(f"rates[{i}][{i}]", "the diagonal is minus the sum of the row and must be None")
            for j, rate in enumerate(row):
                if rate is not None and not isinstance(rate, Rate):
                    raise FieldError(f"rates[{i}][{j}]", f"{rate!r} is not a rate (see design.processes.rates)")
        totals: list[PiecewiseLinearRate | None] = []
        tables: list[tuple[FloatArray, FloatArray] | None] = []
        for row in self.rates:
            present = [rate for rate in row if rate is not None]
            linear = [rate for rate in present if isinstance(rate, PiecewiseLinearRate)]
            closed = len(linear) == len(present)
            totals.append(_sum_piecewise_linear(linear) if closed and linear else None)
            tables.append(None if closed else self._inversion_table(present))
        object.__setattr__(self, "_totals", tuple(totals))
        object.__setattr__(self, "_tables", tuple(tables))

    @staticmethod
    def _inversion_table(rates: Sequence[Rate]) -> tuple[FloatArray, FloatArray]:
        # Reaches H = 50 (a sojourn longer than that has probability 2e-22) or gives up growing: the rate may die out.
        scale = next((b for rate in rates for b in rate.breaks), 1.0)
        octaves = [np.ldexp(1.0 + np.arange(16) / 16.0, e) for e in range(-30, 30)]
        grid = np.concatenate([[0.0], scale * np.concatenate(octaves)])
        total = np.sum([rate.integral(grid) for rate in rates], axis=0)
        keep = np.searchsorted(total, 50.0) + 1
        fine = np.interp(np.linspace(0.0, total[: keep + 1][-1], 1024), total[: keep + 1], grid[: keep + 1])
        nodes = np.unique(np.concatenate([grid[:keep], fine]))
        return nodes, np.sum([rate.integral(nodes) for rate in rates], axis=0)

    @property
    def modes(self) -> int:
        """Number of modes N."""
        return len(self.rates)

    def targets(self, mode: int) -> tuple[int, ...]:
        """The modes that a jump from ``mode`` can lead to."""
        return tuple(j for j, rate in enumerate(self.rates[mode]) if rate is not None)

    def settled(self, mode: int) -> float:
        """Sojourn time (s) after which all rates out of the mode are constant; ``inf`` if never."""
        return max((rate.settled for rate in self.rates[mode] if rate is not None), default=0.0)

    def limit(self, mode: int) -> float:
        """Where the total rate out of the mode tends to (1/s); nan where a rate does not say."""
        rates = [rate for rate in self.rates[mode] if rate is not None]
        return math.fsum(rate.limit if isinstance(rate, TendingRate) else math.nan for rate in rates)

    def breaks(self, mode: int) -> tuple[float, ...]:
        """Sojourn times (s) at which a rate out of the mode is not smooth."""
        return tuple(sorted({b for rate in self.rates[mode] if rate is not None for b in rate.breaks}))

    def rate(self, mode: int, h: npt.ArrayLike) -> FloatArray:
        """Rates (1/s) out of the mode at sojourn time h: shape h.shape + (N,), the diagonal entry is 0."""
        h = np.asarray(h, dtype=float)
        return np.stack([np.zeros_like(h) if rate is None else rate(h) for rate in self.rates[mode]], axis=-1)

    def integral(self, mode: int, h: npt.ArrayLike) -> FloatArray:
        """Total H_i(h) of all rates out of the mode (dimensionless)."""
        h = np.asarray(h, dtype=float)
        return np.asarray(sum((rate.integral(h) for rate in self.rates[mode] if rate is not None), np.zeros_like(h)))

    def bounds(self, mode: int, start: float, stop: float) -> tuple[FloatArray, FloatArray]:
        """Infimum and supremum of every rate out of the mode over [start, stop) (1/s), each of shape (N,)."""
        pairs = [(0.0, 0.0) if rate is None else rate.bounds(start, stop) for rate in self.rates[mode]]
        return np.array([low for low, _ in pairs]), np.array([high for _, high in pairs])

    def sojourn(self, mode: int, target: npt.ArrayLike) -> FloatArray:
        """The sojourn time h (s) at which H_i(h) = target; ``inf`` where the rates never accumulate that much."""
        target = np.asarray(target, dtype=float)
        total = self._totals[mode]
        if total is not None:
            return total.inverse_integral(target)
        table = self._tables[mode]
        if table is None:
            return np.full_like(target, np.inf)
        return self._newton(mode, np.atleast_1d(target), *table).reshape(target.shape)

    def _newton(self, mode: int, target: FloatArray, nodes: FloatArray, values: FloatArray) -> FloatArray:
        cell = np.clip(np.searchsorted(values, target, side="left"), 1, nodes.size - 1)
        low, high = nodes[cell - 1].copy(), nodes[cell].copy()
        beyond = target > values[-1]
        for _ in range(60):  # beyond the table: double the bracket until it holds the root or the rate has died out
            if not beyond.any():
                break
            low[beyond], high[beyond] = high[beyond], 2.0 * high[beyond]
            beyond[beyond] = self.integral(mode, high[beyond]) < target[beyond]
        span = values[cell] - values[cell - 1]
        part = np.divide(target - values[cell - 1], span, out=np.full_like(span, 0.5), where=span > 0)
        h = low + np.clip(part, 0.0, 1.0) * (high - low)
        done = np.zeros(h.shape, dtype=np.bool_)
        for _ in range(80):
            error = self.integral(mode, h) - target
            low, high = np.where(error <= 0, h, low), np.where(error >= 0, h, high)
            slope = self.rate(mode, h).sum(axis=-1)
            with np.errstate(divide="ignore", invalid="ignore"):
                step = h - error / slope
            inside = (step > low) & (step < high) | (step == h)  # by less than rounding: it is found, and an end of the bracket
            new = np.where(done | (error == 0.0), h, np.where(inside, step, 0.5 * (low + high)))
            done |= np.abs(new - h) <= 4e-16 * np.abs(new)  # it stays: no draw depends on those beside it
            h = new
            if done.all():
                break
        h[beyond] = np.inf
        return h

    def choose(self, mode: int, h: FloatArray, uniform: FloatArray) -> IntArray:
        """The mode that a jump from ``mode`` at sojourn time h leads to, given U in [0, 1)."""
        targets = self.targets(mode)
        if len(targets) == 1:
            return np.full(h.shape, targets[0], dtype=np.intp)
        weights = np.cumsum(self.rate(mode, np.where(np.isfinite(h), h, 0.0)), axis=-1)
        picked = (uniform[..., None] * weights[..., -1:] >= weights).sum(axis=-1)
        return np.asarray(np.minimum(picked, targets[-1]), dtype=np.intp)

    def jump(
        self, mode: npt.ArrayLike, age: npt.ArrayLike, exponential: npt.ArrayLike, uniform: npt.ArrayLike
    ) -> tuple[FloatArray, IntArray]:
        """The clock reading h > age (s) of the next jump and its target, exactly, for arrays of runs.

        Args:
            mode: present modes, shape (R,).
            age: present clock readings (s), shape (R,) or scalar.
            exponential: draws of Exp(1), shape (R,).
            uniform: draws of U[0, 1), shape (R,).

        Returns:
            h (s), ``inf`` where no jump comes any more (the target is then the present mode), and the target modes.
        """
        mode, exponential = np.asarray(mode, dtype=np.intp), np.asarray(exponential, dtype=float)
        age_, uniform_ = np.asarray(age, dtype=float), np.asarray(uniform, dtype=float)
        mode, age_, exponential, uniform_ = np.broadcast_arrays(mode, age_, exponential, uniform_)
        h = np.full(mode.shape, np.inf)
        target = mode.copy()
        for i in range(self.modes):
            here = mode == i
            if not here.any() or not self.targets(i):
                continue
            start = self.integral(i, age_[here]) if np.any(age_[here]) else 0.0
            sojourn = self.sojourn(i, start + exponential[here])
            h[here] = sojourn
            target[here] = np.where(np.isfinite(sojourn), self.choose(i, sojourn, uniform_[here]), i)
        return h, target

    def next_jump(self, mode: npt.ArrayLike, rng: np.random.Generator, age: npt.ArrayLike = 0.0) -> tuple[FloatArray, IntArray]:
        """As ``jump``, with E and U drawn from the generator."""
        shape = np.shape(mode)
        return self.jump(mode, age, rng.standard_exponential(shape), rng.random(shape))


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultDetection:
    """Failure process eta and detection process r of Chapter 4, with one clock each.

    Args:
        failure: lambda_ij(h_eta), N_eta modes.
        detection: for every failure mode i the process pi^(i)_kl(h_r), all with the same number N_r of modes.
        failure_restarts_detection_clock: whether a jump of eta sets h_r to 0 too. No default: the thesis does not say.
    """

    failure: SemiMarkov
    detection: tuple[SemiMarkov, ...]
    failure_restarts_detection_clock: bool

    def __post_init__(self) -> None:
        if len(self.detection) != self.failure.modes:
            raise FieldError("detection", f"{len(self.detection)} processes for {self.failure.modes} failure modes")
        for i, process in enumerate(self.detection):
            if process.modes != self.detection[0].modes:
                raise FieldError(f"detection[{i}]", f"{process.modes} modes, expected {self.detection[0].modes}")


@dataclass(frozen=True, slots=True, kw_only=True)
class JumpPath:
    """A path of a semi-Markov process: mode ``modes[k]`` holds on [times_s[k], times_s[k+1]); times_s[0] = 0."""

    times_s: FloatArray
    modes: IntArray

    def at(self, t: npt.ArrayLike) -> tuple[IntArray, FloatArray]:
        """Mode and sojourn time (s) at the instants t (s)."""
        t = np.asarray(t, dtype=float)
        index = np.searchsorted(self.times_s, t, side="right") - 1
        return self.modes[index], t - self.times_s[index]


def sample_path(process: SemiMarkov, mode: int, duration_s: float, rng: np.random.Generator) -> JumpPath:
    """One path over [0, duration_s], its first sojourn clock at 0."""
    times, modes = [0.0], [mode]
    while True:
        h, target = process.next_jump(np.array([modes[-1]]), rng)
        if times[-1] + h[0] >= duration_s:
            return JumpPath(times_s=np.array(times), modes=np.array(modes, dtype=np.intp))
        times.append(times[-1] + float(h[0]))
        modes.append(int(target[0]))


def sample_fault_detection(
    process: FaultDetection, failure_mode: int, detection_mode: int, duration_s: float, rng: np.random.Generator
) -> tuple[JumpPath, JumpPath]:
    """One path of (eta, r) over [0, duration_s], both clocks at 0 at the start: the paths of eta and of r.

    The path of r has a node wherever its clock restarts, so that ``at`` gives its clock under either reset rule.
    """
    failure = sample_path(process.failure, failure_mode, duration_s, rng)
    times, modes, clock = [0.0], [detection_mode], 0.0
    edges = [*failure.times_s[1:].tolist(), duration_s]
    now = 0.0
    for i, until in zip(failure.modes.tolist(), edges):
        while True:
            age = now - clock
            h, target = process.detection[i].next_jump(np.array([modes[-1]]), rng, age)
            if clock + h[0] >= until:
                break
            now = clock = clock + float(h[0])
            times.append(now)
            modes.append(int(target[0]))
        now = until
        if process.failure_restarts_detection_clock and until < duration_s:
            clock = until
            times.append(until)
            modes.append(modes[-1])
    return failure, JumpPath(times_s=np.array(times), modes=np.array(modes, dtype=np.intp))
