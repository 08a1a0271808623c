"""The second moments of a sampled loop from one seen change of mode to the next, between two sides that are proved.

A sojourn is *seen* from the first sample in the mode on, and counted in whole samples: c = 0, 1, ... Its true age at that sample
is in [c T, (c + 1) T]. A mode that is left and entered again between two samples is not seen to change: the count goes on, the
true clock starts anew (``hidden`` sojourns). With U_c the moments that reach count c,

    R_ji = sum_c (J_ij U_c + W_j (moments that become hidden)),        U_c+1 = e^(-lambda_i T) Psi_c (x) Psi_c U_c,

all maps taken at rates that make them larger (``upper``) or smaller. Where the gains no longer change, W follows from one
backward pass over the age; before that, hidden sojourns are held in about ``BINS`` groups of similar age. The loop is mean-square
stable if the radius of the larger R is below 1 and its endless sojourns contract; not if the radius of the smaller R is above 1.

Reference: thesis (2.1), (2.16), sampled; ``second_moments`` is the same test where the feedback acts at every instant.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from design.controllers.scheduled_gain import ScheduledGain
from design.errors import FieldError
from design.processes.semi_markov import IntArray, SemiMarkov
from design.semi_markov_loop import FloatArray, JumpSystem
from design.semi_markov_loop.period_moments import Box, PeriodMoments, TooLarge, congruence, period_moments, svec_size

BINS = 64
CELLS = 100_000
"""Most periods for which one sojourn is followed before its rates are taken anywhere within their bounds."""
WORK = 2e11
"""Most multiplications of one pass."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RatesByAge:
    """Rate bounds of a mode on [c T, (c + 1) T), c = 0 ... C - 1, and on [C T, inf) as entry C; shape (C + 1, N)."""

    low: FloatArray
    high: FloatArray

    @property
    def end(self) -> int:
        return int(self.low.shape[0]) - 1

    def over(self, first: int, last: int) -> Box:
        """Bounds over the cells first to last."""
        a, b = max(0, min(first, self.end)), min(last, self.end)
        return Box(low=self.low[a : b + 1].min(axis=0), high=self.high[a : b + 1].max(axis=0))


def rates_by_age(process: SemiMarkov, mode: int, period_s: float) -> RatesByAge:
    settled = process.settled(mode)
    end = math.ceil(settled / period_s) if settled < CELLS * period_s else 64
    while not math.isfinite(settled) and end < CELLS:
        low, high = process.bounds(mode, end * period_s, math.inf)
        if (high - low <= 1e-3 * np.maximum(high, 1e-9)).all():
            break
        end *= 2
    end = min(end, CELLS)
    cells = [(c * period_s, (c + 1) * period_s if c < end else math.inf) for c in range(end + 1)]
    bounds = np.zeros((2, end + 1, process.modes))
    for j, rate in enumerate(process.rates[mode]):
        if rate is not None:
            bounds[:, :, j] = np.transpose([rate.bounds(*cell) for cell in cells])
    low, high = bounds
    if not np.isfinite(high).all():
        where = int(np.argwhere(~np.isfinite(high))[0][0])
        raise FieldError(f"rates[{mode}]", f"no finite bound from {where * period_s:g} s on; clip it")
    return RatesByAge(low=low, high=high)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SampledLoop:
    """A sampled jump loop with a constant delay: u(k) = K(mode, count) x(k - tau - d).

    Args:
        system: certain matrices.
        process: the rates.
        gain: the gains; the sojourn time that they see is (count + tau) T.
        period_s: T (s).
        tau: age of the samples at the controller, in periods.
        d: age of the packets at the actuator, in periods.
    """

    system: JumpSystem
    process: SemiMarkov
    gain: ScheduledGain
    period_s: float
    tau: int
    d: int

    @property
    def delay(self) -> int:
        """D = tau + d."""
        return self.tau + self.d

    @property
    def size(self) -> int:
        """Length of xi = (x, v_0, ..., v_-(D-1)) at a sample."""
        return self.system.states + self.system.inputs * self.delay

    def last_count(self, mode: int) -> int:
        """The count from which on the gain of a mode no longer changes."""
        last: float = self.gain.starts_s[mode, -1].item()
        count = max(0, math.floor(last / self.period_s) - self.tau - 1)
        while (count + self.tau) * self.period_s < last:
            count += 1
        return count

    def sampled(self, mode: int, count: int) -> FloatArray:
        """The map from xi to z = (x, v_0, v_-1, ...): the sample is taken and v_0 = K x computed."""
        return self.sampled_at(self.gain.at(mode, (count + self.tau) * self.period_s))

    def sampled_at(self, gain: FloatArray) -> FloatArray:
        """The same map at a gain, shape (xi + m, xi)."""
        n, m = self.system.states, self.system.inputs
        out = np.zeros((self.size + m, self.size))
        out[:n, :n] = np.eye(n)
        out[n : n + m, :n] = gain
        out[n + m :, n:] = np.eye(self.size - n)
        return out


def check_size(loop: SampledLoop) -> None:
    """Raise TooLarge where the maps of one period do not fit."""
    modes, q = loop.system.modes, svec_size(loop.size + loop.system.inputs)
    if modes * q > 1500 or 6.0 * modes**3 * q**2 > 5e7:
        raise TooLarge(f"{modes} modes and {loop.size} states with delayed inputs are too many")


def renewal_matrix(loop: SampledLoop, modes: Sequence[int], *, upper: bool, slack: float = 0.0) -> FloatArray | None:
    """R of the module's docstring, shape (N, p, N, p), or None where the moments of an endless sojourn do not stay finite.

    Args:
        loop: the loop.
        modes: the modes that can be reached, counted from 0; the columns of the others are 0.
        upper: whether R bounds the true map from above or from below.
        slack: epsilon of ``uncertain_moments`` where the system is uncertain (1/s).

    Raises:
        ValueError: rates without a finite bound.
        TooLarge: more work than ``WORK``.
    """
    count, p = loop.system.modes, svec_size(loop.size)
    ages = [rates_by_age(loop.process, i, loop.period_s) for i in range(count)]
    check_size(loop)
    steps = sum(max(loop.last_count(i), 2 * a.end) for i, a in enumerate(ages))
    if steps * count * 8.0 * p**3 > WORK:
        raise TooLarge(f"{loop.size} states with delayed inputs over {steps} periods of the sojourns are too much work")
    maps = period_moments(loop.system, [a.over(0, 0) for a in ages], loop.period_s, loop.delay, upper, slack)
    out = np.zeros((count, p, count, p))
    for i in modes:
        column = _Sojourn(loop, maps, i, ages[i], upper).out()
        if column is None:
            return None
        out[:, :, i, :] = column
    return out


class _Sojourn:
    """One side of the sojourns in one mode."""

    def __init__(self, loop: SampledLoop, maps: PeriodMoments, mode: int, ages: RatesByAge, upper: bool) -> None:
        self._loop, self._maps, self._mode, self._ages, self._upper = loop, maps, mode, ages, upper
        self._gain, self._still, self._leaps = np.zeros(0), np.zeros((0, 0)), np.zeros((0, 0, 0, 0))
        self._flat = np.zeros((0, 0))
        self._known: dict[tuple[int, int], tuple[float, FloatArray]] = {}  # groups of one width meet the same ages one by one

    def out(self) -> FloatArray | None:
        """The moments at the first sample in every mode from those at the first sample in this one, shape (N, p, p)."""
        last, end = self._loop.last_count(self._mode), self._ages.end
        width = max(8, math.ceil(last / BINS))
        p = svec_size(self._loop.size)
        young, old, moments = np.array([0]), np.array([1]), np.eye(p)[None]  # the first group is the seen sojourn
        total = np.zeros((self._loop.system.modes, p, p))
        for count in range(last):
            self._at(count)
            stay, left = self._apply(young, old, moments)
            hidden = left[self._mode].copy()
            left[self._mode] = 0.0
            total += left
            young, old, moments = young + 1, old + 1, stay
            if young.size > 1 and old[-1] < width:  # the newest group still takes members
                young[-1], moments[-1] = 0, moments[-1] + hidden
            else:
                young, old, moments = np.append(young, 0), np.append(old, 1), np.append(moments, hidden[None], axis=0)
        self._at(last)
        backward = self._backward(width, sorted({0, *np.minimum(young[1:], end).tolist()}))
        if backward is None:
            return None
        for age, group in zip(young[1:], moments[1:]):
            total += backward[min(int(age), end)] @ group
        seen = moments[:1]
        again = np.zeros((p, p))
        for count in range(last, max(last, end)):
            seen, left = self._apply(np.array([count]), np.array([count + 1]), seen)
            again += left[self._mode]
            left[self._mode] = 0.0
            total += left
        endless = self._endless()
        if endless is None:
            return None
        _, left = self._apply(np.array([end]), np.array([end]), (endless @ seen[0])[None])
        again += left[self._mode]
        left[self._mode] = 0.0
        return np.asarray(total + left + backward[0] @ again)

    def _at(self, count: int) -> None:
        gain = self._loop.gain.at(self._mode, (count + self._loop.tau) * self._loop.period_s)
        if not np.array_equal(gain, self._gain):
            lift = congruence(self._loop.sampled(self._mode, count))
            self._gain, self._still = gain, self._maps.still[self._mode] @ lift
            self._leaps = self._maps.jumped[self._mode] @ lift
            modes, p = self._leaps.shape[1], self._leaps.shape[-1]
            self._flat = np.transpose(self._leaps, (1, 3, 0, 2, 4)).reshape(modes * p, -1)  # (l p, j g q)

    def _weights(self, young: IntArray, old: IntArray) -> tuple[FloatArray, FloatArray]:
        # of the still paths, shape (groups,), and of a first jump to j at node g, shape (groups, N, G)
        found = [self._weights_over(a, b) for a, b in zip(young.tolist(), old.tolist())]
        return np.array([still for still, _ in found]), np.array([jump for _, jump in found])

    def _weights_over(self, young: int, old: int) -> tuple[float, FloatArray]:
        known = self._known.get((young, old))
        if known is None:
            box = self._ages.over(young, old)
            leave = box.leave(self._upper)
            nodes = self._maps.weights_s * np.exp(-leave * self._maps.nodes_s)
            known = math.exp(-leave * self._maps.period_s), np.multiply.outer(box.jump(self._upper), nodes)
            if len(self._known) > CELLS // 4:
                self._known.clear()
            self._known[young, old] = known
        return known

    def _apply(self, young: IntArray, old: IntArray, moments: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The groups after one period, and the moments after a jump by the mode at its end."""
        still, jump = self._weights(young, old)
        groups, p, r = moments.shape
        weighed = jump.reshape(groups, -1).T @ moments.reshape(groups, -1)  # (modes and nodes, p r)
        left = self._flat @ weighed.reshape(-1, r)
        return still[:, None, None] * (self._still @ moments), left.reshape(-1, p, r)

    def _endless(self) -> FloatArray | None:
        """(I - map of one period without a jump)^-1 once the rates have settled."""
        still, _ = self._weights(np.array([self._ages.end]), np.array([self._ages.end]))
        stay = still[0] * self._still
        if np.abs(np.linalg.eigvals(stay)).max() >= 1.0 - 1e-12:
            return None
        return np.linalg.inv(np.eye(stay.shape[0]) - stay)

    def _backward(self, width: int, wanted: list[int]) -> dict[int, FloatArray] | None:
        """From hidden sojourns of the wanted ages (at most ``width`` periods older), at the last gain, to the seen changes."""
        end, unit = self._ages.end, np.eye(self._still.shape[0])
        endless = self._endless()
        if endless is None:
            return None
        after = None
        found: dict[int, FloatArray] = {}
        for age in range(end, -1, -1):
            still, jump = self._weights(np.array([age]), np.array([age + width]))
            leap = np.einsum("jg,jlgpq->lpq", jump[0], self._leaps)
            after = leap @ endless if after is None else leap + still[0] * (after @ self._still)
            if age in wanted:
                found[age] = after.copy()
        again = found[0][self._mode]
        if np.abs(np.linalg.eigvals(again)).max() >= 1.0 - 1e-12:
            return None
        closed = np.linalg.inv(unit - again)
        out = {}
        fresh = found[0].copy()
        fresh[self._mode] = 0.0
        fresh = fresh @ closed
        for age, own in found.items():
            hidden = own[self._mode].copy()
            own[self._mode] = 0.0
            out[age] = own + fresh @ hidden
        out[0] = fresh
        return out


def renewal_radius(loop: SampledLoop, modes: Sequence[int], *, upper: bool, slack: float = 0.0) -> float:
    """The spectral radius of R; ``inf`` where R does not exist. Raises as ``renewal_matrix``."""
    matrix = renewal_matrix(loop, modes, upper=upper, slack=slack)
    if matrix is None:
        return math.inf
    size = matrix.shape[0] * matrix.shape[1]
    return float(np.abs(np.linalg.eigvals(matrix.reshape(size, size))).max())
