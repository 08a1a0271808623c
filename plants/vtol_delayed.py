"""The VTOL of Chapter 3: airspeeds that change at random, and a state delay that changes all the time."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from plants.errors import FieldError
from plants.parts.draws import TURN, sine
from plants.parts.events import HeldNoise, JumpModel, JumpRates, Source, pass_time
from plants.parts.exponential import Rows, dot, drift, zero_order_hold
from plants.parts.linear import NS_PER_S, Signal, StateSpace
from plants.parts.semi_markov import JumpProcess, TransitionRates, check_mode
from plants.parts.validation import (
    require_finite,
    require_not_negative,
    require_positive,
    require_vector,
    require_whole_nanoseconds,
)
from plants.vtol import AIRSPEEDS_KN, VTOL_INPUTS, VTOL_STATES, vtol_matrices

# Lower, middle and upper bounds of sec. 3.4. Only the section boundary 1.8 s is printed; that the rates rise linearly over
# 0, 1.8 and 3.6 s is an assumption.
_RATES = TransitionRates(
    nodes_s=(0.0, 1.8, 3.6),
    rates=(
        ((-0.3, 0.1, 0.2), (0.2, -0.5, 0.3), (0.3, 0.3, -0.6)),
        ((-1.2, 0.5, 0.7), (0.7, -1.7, 1.0), (1.0, 1.1, -2.1)),
        ((-2.0, 0.8, 1.2), (0.9, -2.4, 1.5), (1.8, 2.2, -4.0)),
    ),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class DelayedVTOL:
    """VTOL with a state delay and three airspeeds: x' = A_i x + 0.1 A_i x(t - tau(t, i)) + B_i (u + w + omega).

    tau(t, i) = (max_delay/2) (sin(2 h_i t/max_delay) + 1), rounded to 1 ns; x(t) = x(0) for t < 0; i is the mode of a
    semi-Markov process. The measurement is the full state and the mode (1, 2, 3 for 135, 60, 170 knots).

    Between events the undelayed part is exact, and the delayed term is linear in time over sub-steps on a fixed grid; the
    history is read by linear interpolation. The error falls with the square of the sub-step; at 1 ms it is below 1e-7 of
    the state's size (measured: tests/plants/test_vtol_delayed.py). Cutting an advance at a whole number of sub-steps
    changes nothing, elsewhere it changes the result within that error.

    Args:
        initial_state: horizontal and vertical velocity in knots, pitch rate in deg/s, pitch angle in deg.
        initial_mode: 1, 2 or 3.
        max_delay_s: largest delay in s, above 0.
        delay_rates: h_i, bound of the rate of change of the delay in every mode (below 1 in the thesis).
        delayed_share: A_di = delayed_share A_i; 0.1 is the example.
        rates: transition rates of the mode.
        noise_std: standard deviation of each sample of omega.
        noise_period_s: time over which a sample of omega is held, in s.
        substep_s: sub-step in s.

    Raises:
        ValueError: where a parameter is out of range.

    Reference: thesis sec. 3.4, (3.43), Table 3.1.
    """

    initial_state: tuple[float, ...] = (10.0, 6.0, 1.0, -7.0)
    initial_mode: int = 1
    max_delay_s: float = 0.3
    delay_rates: tuple[float, ...] = (0.5, 0.6, 0.3)
    delayed_share: float = 0.1
    rates: TransitionRates = _RATES
    noise_std: float = 1.0
    noise_period_s: float = 0.01
    substep_s: float = 0.001

    inputs: ClassVar[tuple[Signal, ...]] = VTOL_INPUTS
    outputs: ClassVar[tuple[Signal, ...]] = (*VTOL_STATES, Signal("mode", "1"))
    states: ClassVar[tuple[Signal, ...]] = (*VTOL_STATES, Signal("mode", "1"), Signal("delay", "s"))
    tracked: ClassVar[tuple[str, ...]] = tuple(s.name for s in VTOL_STATES)

    def __post_init__(self) -> None:
        require_vector("initial_state", self.initial_state, 4)
        check_mode("initial_mode", self.initial_mode, 3)
        require_positive("max_delay_s", self.max_delay_s)
        require_vector("delay_rates", self.delay_rates, 3)
        for i, rate in enumerate(self.delay_rates):
            require_not_negative(f"delay_rates[{i}]", rate)
        require_finite("delayed_share", self.delayed_share)
        if self.rates.modes != 3:
            raise FieldError("rates.rates", f"{self.rates.modes} modes, expected 3")
        require_not_negative("noise_std", self.noise_std)
        require_whole_nanoseconds("noise_period_s", self.noise_period_s)
        require_whole_nanoseconds("substep_s", self.substep_s)
        if self.max_delay_s / self.substep_s > 1e6:
            raise FieldError("substep_s", f"{self.substep_s!r}, expected at least a millionth of max_delay_s")

    def models(self) -> tuple[StateSpace, ...]:
        """Return the three models without delay; the output's last entry, the mode, has a row of zeros."""
        pairs = [vtol_matrices(airspeed) for airspeed in AIRSPEEDS_KN]
        return tuple(StateSpace(A=A, B=B, C=np.eye(5, 4)) for A, B in pairs)

    def model(self) -> StateSpace:
        """Return the model at 135 knots without delay."""
        return self.models()[0]

    def jump_system(self) -> JumpModel:
        """Return the three airspeeds with their delayed state; w enters through B, z is a tenth of the vertical velocity."""
        A, B = zip(*(vtol_matrices(airspeed) for airspeed in AIRSPEEDS_KN))
        share = self.delayed_share
        return JumpModel(
            A=A, B=B, E=B, C=(((0.0, 0.1, 0.0, 0.0),),) * 3,
            Ad=tuple(tuple(tuple(share * a for a in row) for row in rows) for rows in A),
            max_delay_s=self.max_delay_s, delay_slopes=self.delay_rates,
        )  # fmt: skip

    def jump_process(self) -> JumpRates:
        """Return the rates of the airspeed, which is measured."""
        return JumpRates(rates=self.rates)

    def delay_ns(self, mode: int, t_ns: int) -> int:
        """Return tau(t, i) of (3.43) in ns, for mode 1, 2 or 3."""
        angle = 2.0 * self.delay_rates[mode - 1] * (t_ns / NS_PER_S) / self.max_delay_s
        return round(0.5 * NS_PER_S * self.max_delay_s * (sine(angle / TURN) + 1.0))

    def start(self, rng: np.random.Generator) -> DelayedVTOLRun:
        """Return the helicopter at time 0; jumps and noise are drawn from two streams spawned from ``rng``."""
        return DelayedVTOLRun(self, rng)


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
    """The running helicopter. See `DelayedVTOL` for the equations."""

    __slots__ = (
        "_applied",
        "_flows",
        "_instants",
        "_mode",
        "_noise",
        "_now_ns",
        "_oldest_ns",
        "_past",
        "_plant",
        "_room",
        "_sources",
        "_step_ns",
        "_v",
        "_x",
    )

    def __init__(self, plant: DelayedVTOL, rng: np.random.Generator) -> None:
        jumps, noise = rng.spawn(2)
        self._plant = plant
        self._mode = JumpProcess(plant.rates, plant.initial_mode, jumps)
        self._noise = HeldNoise(2, plant.noise_std, round(plant.noise_period_s * NS_PER_S), noise)
        self._sources: tuple[Source, ...] = (self._mode, self._noise)
        self._step_ns = round(plant.substep_s * NS_PER_S)
        self._flows = [_DelayedFlow(*vtol_matrices(airspeed), plant.delayed_share, self._step_ns) for airspeed in AIRSPEEDS_KN]
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
        flow, delay_ns = self._flows[mode - 1], self._plant.delay_ns
        b, pushed = flow.force([a + c for a, c in zip(self._v, self._noise.values)])
        x, now_ns = self._x, from_ns
        z = self._at(now_ns - delay_ns(mode, now_ns))
        while now_ns < to_ns:
            stop_ns = min(to_ns, (now_ns // step_ns + 1) * step_ns)
            span_ns = stop_ns - now_ns
            wanted_ns = stop_ns - delay_ns(mode, stop_ns)
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
        return (*self._x, float(mode), self._plant.delay_ns(mode, self._now_ns) / NS_PER_S)

    @property
    def applied(self) -> tuple[float, ...]:
        """The input of the last advance, without the disturbance."""
        return self._applied
