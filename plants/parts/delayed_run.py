"""The running VTOL of Chapter 3: jumps, held noise, and a delayed state that is read from its history."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from plants.parts import NS_PER_S
from plants.parts.draws import TURN, sine
from plants.parts.exponential import Rows, dot, drift, zero_order_hold
from plants.parts.flow import HeldNoise, JumpProcess, Source, pass_time

if TYPE_CHECKING:
    from plants.vtol import DelayedVTOL


def delay_ns(max_delay_s: float, rate: float, t_ns: int) -> int:
    """Return tau(t, i) of (3.43) in ns.

    Args:
        max_delay_s: largest delay in s.
        rate: h_i of the mode, bound of the rate of change of the delay.
        t_ns: t in ns.
    """
    angle = 2.0 * rate * (t_ns / NS_PER_S) / max_delay_s
    return round(0.5 * NS_PER_S * max_delay_s * (sine(angle / TURN) + 1.0))


class _DelayedFlow:
    """One mode over one sub-step: x' = A x + A_d z(t) + b, with z linear in time, solved exactly.

    x(h) = Phi x + (G_0 - G_1) A_d z(0) + G_1 A_d z(h) + G_0 b, with G_0 = int_0^h e^(A s) ds and
    G_1 = int_0^h e^(A (h-s)) s/h ds; G_1 is read off the hold of the plant behind an integrator.
    """

    __slots__ = ("_A", "_B", "_delayed", "_hold", "_norm", "_step_ns", "_whole")

    def __init__(self, A: Rows, B: Rows, share: float, step_ns: int) -> None:
        n = len(A)
        self._A, self._B, self._step_ns = A, B, step_ns
        self._norm = max(math.fsum(map(abs, row)) for row in A)
        self._delayed: Rows = tuple(tuple(share * a for a in row) for row in A)
        unit = [[1.0 if i == j else 0.0 for j in range(n)] for i in range(n)]
        chain = [[*a, *e] for a, e in zip(A, unit)] + [[0.0] * (2 * n)] * n
        ratio = (step_ns, NS_PER_S)
        Phi, _ = zero_order_hold(A, B, ratio)
        transition, ramp = zero_order_hold(chain, [[0.0] * n] * n + unit, ratio)
        h = step_ns / NS_PER_S
        self._hold = tuple(row[n:] for row in transition[:n])
        G_1 = [[g / h for g in row] for row in ramp[:n]]
        columns = list(zip(*self._delayed))
        late = [[dot(row, column) for column in columns] for row in G_1]
        early = [[dot(row, column) - g for column, g in zip(columns, rest)] for row, rest in zip(self._hold, late)]
        self._whole: Rows = tuple((*p, *e, *g) for p, e, g in zip(Phi, early, late))

    def force(self, v: Sequence[float]) -> tuple[list[float], list[float]]:
        """Return b = B v, and what it adds over a whole sub-step."""
        b = [dot(row, v) for row in self._B]
        return b, [dot(row, b) for row in self._hold]

    def step(
        self, x: list[float], z0: list[float], z1: list[float], b: list[float], pushed: list[float], span_ns: int
    ) -> list[float]:
        """Return x after span_ns, where the delayed state goes from z0 to z1."""
        if span_ns == self._step_ns:
            held = (*x, *z0, *z1)
            return [dot(row, held) + p for row, p in zip(self._whole, pushed)]
        h = span_ns / NS_PER_S
        start = [dot(row, z0) for row in self._delayed]
        slope = [(dot(row, z1) - f) / h for row, f in zip(self._delayed, start)]
        return drift(self._A, self._norm, x, [f + g for f, g in zip(start, b)], h, slope)


class DelayedVTOLRun:
    """The running helicopter. See `DelayedVTOL` for the equations.

    Args:
        plant: its parameters.
        models: A_i and B_i of every mode.
        rng: jumps and noise are drawn from two streams spawned from it.
    """

    __slots__ = (
        "_applied", "_delay_rates", "_flows", "_instants", "_max_delay_s", "_mode", "_noise", "_now_ns", "_oldest_ns", "_past",
        "_room", "_sources", "_step_ns", "_v", "_x",
    )  # fmt: skip

    def __init__(self, plant: DelayedVTOL, models: Sequence[tuple[Rows, Rows]], rng: np.random.Generator) -> None:
        jumps, noise = rng.spawn(2)
        self._max_delay_s, self._delay_rates = plant.max_delay_s, plant.delay_rates
        self._mode = JumpProcess(plant.rates, plant.initial_mode, jumps)
        self._noise = HeldNoise(2, plant.noise_std, round(plant.noise_period_s * NS_PER_S), noise)
        self._sources: tuple[Source, ...] = (self._mode, self._noise)
        self._step_ns = round(plant.substep_s * NS_PER_S)
        self._flows = [_DelayedFlow(A, B, plant.delayed_share, self._step_ns) for A, B in models]
        self._x = [float(x) for x in plant.initial_state]
        self._applied: tuple[float, ...] = (0.0, 0.0)
        self._v: tuple[float, ...] = (0.0, 0.0)
        self._now_ns = 0
        self._instants, self._past = [0], [self._x]
        self._oldest_ns = round(plant.max_delay_s * NS_PER_S) + 1
        self._room = 4 * (self._oldest_ns // self._step_ns) + 1000

    def advance(self, dt_ns: int, u: Sequence[float], w: Sequence[float] = ()) -> None:
        """Hold u + w for dt_ns, through every jump and every noise sample that falls into it."""
        self._applied = tuple(u)
        self._v = tuple(a + b for a, b in zip(u, w)) if w else self._applied
        pass_time(self._now_ns, self._now_ns + dt_ns, self._sources, self._move)
        self._now_ns += dt_ns

    def _move(self, from_ns: int, to_ns: int) -> None:
        mode, step_ns = self._mode.mode, self._step_ns
        flow, max_delay_s, rate = self._flows[mode - 1], self._max_delay_s, self._delay_rates[mode - 1]
        b, pushed = flow.force([a + c for a, c in zip(self._v, self._noise.values)])
        x, now_ns = self._x, from_ns
        z = self._at(now_ns - delay_ns(max_delay_s, rate, now_ns))
        while now_ns < to_ns:
            stop_ns = min(to_ns, (now_ns // step_ns + 1) * step_ns)
            span_ns = stop_ns - now_ns
            wanted_ns = stop_ns - delay_ns(max_delay_s, rate, stop_ns)
            if wanted_ns <= now_ns:
                z_stop = self._at(wanted_ns)
                after = flow.step(x, z, z_stop, b, pushed, span_ns)
            else:
                # The delay is shorter than the sub-step: what is asked for lies in it. Two corrections of size |A_d| h.
                share = (wanted_ns - now_ns) / span_ns
                z_stop = x
                for _ in range(3):
                    after = flow.step(x, z, z_stop, b, pushed, span_ns)
                    z_stop = [p + share * (q - p) for p, q in zip(x, after)]
            x, z, now_ns = after, z_stop, stop_ns
            self._instants.append(now_ns)
            self._past.append(x)
        self._x = x
        if len(self._instants) > self._room:
            keep = max(0, bisect_right(self._instants, now_ns - self._oldest_ns) - 1)
            del self._instants[:keep], self._past[:keep]

    def _at(self, t_ns: int) -> list[float]:
        """Return x(t) from the history, for t up to now."""
        i = bisect_right(self._instants, t_ns)
        if i == 0:
            return self._past[0]  # x(t) = x(0) before time 0
        if i == len(self._instants):
            return self._past[-1]
        t0, t1 = self._instants[i - 1], self._instants[i]
        share = (t_ns - t0) / (t1 - t0)
        return [p + share * (q - p) for p, q in zip(self._past[i - 1], self._past[i])]

    def measure(self) -> tuple[float, ...]:
        """Return x and the mode (1, 2 or 3)."""
        return (*self._x, float(self._mode.mode))

    @property
    def state(self) -> tuple[float, ...]:
        """x, the mode, and the delay in s."""
        mode = self._mode.mode
        delay = delay_ns(self._max_delay_s, self._delay_rates[mode - 1], self._now_ns)
        return (*self._x, float(mode), delay / NS_PER_S)

    @property
    def applied(self) -> tuple[float, ...]:
        """The input of the last advance, without the disturbance."""
        return self._applied
