"""The example of Chapter 2: two uncertain modes that change at semi-Markov instants."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from plants.errors import FieldError, require_choice, require_not_negative, require_vector, require_whole_nanoseconds
from plants.parts import NEVER_NS, NS_PER_S, Signal, StateSpace
from plants.parts.exponential import Rows
from plants.parts.flow import Flow, JumpProcess, Source, pass_time
from plants.parts.semi_markov import JumpModel, JumpRates, TransitionRates, check_clip, check_mode

_A: tuple[Rows, Rows] = (((1.1555, -0.4006), (-0.4470, -0.7930)), ((-0.0274, 0.0249), (-0.3835, 0.3026)))
_B: tuple[Rows, Rows] = (((1.0,), (1.0,)), ((1.0,), (0.0,)))
# What sigma and rho add, (mode, dA per sigma, dA per rho, dB per rho), in the two readings of the text.
_Change = tuple[Rows, Rows, Rows]
_NONE: Rows = ((0.0, 0.0), (0.0, 0.0))
_UNCERTAINTY: dict[str, tuple[_Change, _Change]] = {
    # E_i delta F_i with (2.25): row 1 of F carries sigma, row 2 carries rho
    "norm-bounded": (
        (((0.2, 0.1), (0.0, 0.0)), ((0.0, 0.0), (0.1, 0.0)), ((0.0,), (0.0,))),
        (_NONE, ((0.0, 0.0), (0.1, 0.0)), ((0.0,), (0.1,))),
    ),
    # A_i(t), B_2(t) as they are printed above it
    "printed": (
        (((0.0, 0.1), (0.0, 0.0)), _NONE, ((0.0,), (0.0,))),
        (_NONE, ((0.0, 0.0), (0.0, 0.7)), ((0.0,), (0.1,))),
    ),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class SwitchedExample:
    """Two-mode plant x' = (A_i + dA_i) x + (B_i + dB_i)(u + w), with i the mode of a semi-Markov process.

    The measurement is the full state and the mode (1 or 2); the controller measures the sojourn time by itself.
    sigma and rho are the uncertain parameters: constant over a run, or drawn anew every period.

    DEVIATION: the F matrices of (2.25) do not give the printed A_i(t). Both readings are here; (2.25) is the default, as the
    feasibility claims of the chapter hold only for it.

    Args:
        initial_state: x at time 0, two entries.
        initial_mode: 1 or 2.
        rate_low, rate_high: bounds of the transition rate in 1/s, see (2.26).
        rate_slope: growth of the rate in 1/s^2; (2.26) has 1, the published Monte Carlo runs very likely had 2.
        uncertainty: "none", "constant" (drawn once from U[-1, 1]) or "sampled" (drawn again every period).
        uncertainty_form: "norm-bounded" for (2.25), "printed" for A_i(t), B_i(t) as printed.
        uncertainty_scale: factor on sigma and rho, at least 0; 1 is the example.
        uncertainty_period_s: time between samples in s, for "sampled".
        sigma, rho: fixed values in [-1, 1] in place of drawn ones; drawn by default.

    Raises:
        ValueError: where a parameter is out of range.

    Reference: thesis sec. 2.5, (2.25), (2.26).
    """

    initial_state: tuple[float, ...] = (5.0, -4.0)
    initial_mode: int = 1
    rate_low: float = 0.1
    rate_high: float = 4.6
    rate_slope: float = 1.0
    uncertainty: Literal["none", "constant", "sampled"] = "constant"
    uncertainty_form: Literal["norm-bounded", "printed"] = "norm-bounded"
    uncertainty_scale: float = 1.0
    uncertainty_period_s: float = 0.1
    sigma: float | None = None
    rho: float | None = None

    inputs: ClassVar[tuple[Signal, ...]] = (Signal("u", "1"),)
    outputs: ClassVar[tuple[Signal, ...]] = (Signal("x1", "1"), Signal("x2", "1"), Signal("mode", "1"))
    states: ClassVar[tuple[Signal, ...]] = (*outputs, Signal("sigma", "1"), Signal("rho", "1"))
    tracked: ClassVar[tuple[str, ...]] = ("x1", "x2")

    def __post_init__(self) -> None:
        require_vector("initial_state", self.initial_state, 2)
        check_mode("initial_mode", self.initial_mode, 2)
        check_clip(self.rate_low, self.rate_high, self.rate_slope)
        require_choice("uncertainty", self.uncertainty, ("none", "constant", "sampled"))
        require_choice("uncertainty_form", self.uncertainty_form, tuple(_UNCERTAINTY))
        require_not_negative("uncertainty_scale", self.uncertainty_scale)
        require_whole_nanoseconds("uncertainty_period_s", self.uncertainty_period_s)
        for name, value in (("sigma", self.sigma), ("rho", self.rho)):
            if value is not None and not -1.0 <= value <= 1.0:
                raise FieldError(name, f"{value!r}, expected a number in [-1, 1]")

    def matrices(self, mode: int, sigma: float = 0.0, rho: float = 0.0) -> tuple[Rows, Rows]:
        """Return A (2 x 2) and B (2 x 1) of a mode (1 or 2) under sigma and rho."""
        dA_sigma, dA_rho, dB_rho = _UNCERTAINTY[self.uncertainty_form][mode - 1]
        A = tuple(tuple(a + sigma * s + rho * r for a, s, r in zip(*rows)) for rows in zip(_A[mode - 1], dA_sigma, dA_rho))
        B = tuple(tuple(b + rho * r for b, r in zip(*rows)) for rows in zip(_B[mode - 1], dB_rho))
        return A, B

    def models(self) -> tuple[StateSpace, StateSpace]:
        """Return the nominal models of the two modes; the output's last entry, the mode, has a row of zeros."""
        first, second = (self.matrices(mode) for mode in (1, 2))
        C = [[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]]
        return StateSpace(A=first[0], B=first[1], C=C), StateSpace(A=second[0], B=second[1], C=C)

    def model(self) -> StateSpace:
        """Return the nominal model of mode 1."""
        return self.models()[0]

    def jump_system(self) -> JumpModel:
        """Return both modes, with the hull of what sigma and rho can do over a run of this plant."""
        scale = 0.0 if self.uncertainty == "none" else self.uncertainty_scale
        free = [(-scale, scale) if fixed is None else (scale * fixed,) for fixed in (self.sigma, self.rho)]
        corners = sorted({(sigma, rho) for sigma in free[0] for rho in free[1]})
        nominal = [self.matrices(mode) for mode in (1, 2)]
        if len(corners) == 1:
            nominal, corners = [self.matrices(mode, *corners[0]) for mode in (1, 2)], []
        changes = []
        for corner in corners:
            pairs = [zip(self.matrices(mode, *corner), nominal[mode - 1]) for mode in (1, 2)]
            dA, dB = zip(*(tuple(_difference(there, here) for there, here in pair) for pair in pairs))
            changes.append((dA, dB))
        return JumpModel(A=tuple(A for A, _ in nominal), B=tuple(B for _, B in nominal), changes=tuple(changes))

    def jump_process(self) -> JumpRates:
        """Return the rates of the mode, which is measured."""
        return JumpRates(rates=self.rates(), initial=(self.initial_mode,))

    def rates(self) -> TransitionRates:
        """Return the transition rates (2.26)."""
        return TransitionRates.clipped(low=self.rate_low, high=self.rate_high, slope=self.rate_slope)

    def start(self, rng: np.random.Generator) -> SwitchedExampleRun:
        """Return the plant at time 0; jumps and uncertainty are drawn from two streams spawned from ``rng``."""
        return SwitchedExampleRun(self, rng)


def _difference(there: Rows, here: Rows) -> Rows:
    return tuple(tuple(a - b for a, b in zip(*rows)) for rows in zip(there, here))


class _Uncertainty:
    """sigma and rho, and the instant at which they change."""

    __slots__ = ("_period_ns", "_plant", "_rng", "next_ns", "rho", "sigma")

    def __init__(self, plant: SwitchedExample, rng: np.random.Generator) -> None:
        self._plant, self._rng = plant, rng
        self._period_ns = round(plant.uncertainty_period_s * NS_PER_S)
        self.next_ns = 0
        self.sigma = self.rho = 0.0
        self.fire()

    def fire(self) -> None:
        plant = self._plant
        if plant.uncertainty == "none":
            self.next_ns = NEVER_NS
            return
        # Both are always drawn, so that fixing one leaves the other as it was.
        drawn = self._rng.uniform(-1.0, 1.0, 2).tolist()
        fixed = (plant.sigma, plant.rho)
        values = [d if f is None else f for d, f in zip(drawn, fixed)]
        self.sigma, self.rho = (plant.uncertainty_scale * v for v in values)
        self.next_ns = NEVER_NS if plant.uncertainty == "constant" else self.next_ns + self._period_ns


class SwitchedExampleRun:
    """The running example. See `SwitchedExample` for the equations."""

    __slots__ = ("_applied", "_flows", "_mode", "_now_ns", "_parameters", "_plant", "_sources", "_step_ns", "_v", "_x")

    def __init__(self, plant: SwitchedExample, rng: np.random.Generator) -> None:
        jumps, uncertain = rng.spawn(2)
        self._plant = plant
        self._mode = JumpProcess(plant.rates(), plant.initial_mode, jumps)
        self._parameters = _Uncertainty(plant, uncertain)
        self._sources: tuple[Source, ...] = (self._mode, self._parameters)
        self._x = [float(x) for x in plant.initial_state]
        self._applied = self._v = (0.0,)
        self._now_ns = self._step_ns = 0
        self._flows: dict[tuple[int, float, float], Flow] = {}

    def advance(self, dt_ns: int, u: Sequence[float], w: Sequence[float] = ()) -> None:
        """Hold u + w for dt_ns, through every jump that falls into it."""
        self._applied = (u[0],)
        self._v = (u[0] + w[0],) if w else (u[0],)
        self._step_ns = dt_ns
        pass_time(self._now_ns, self._now_ns + dt_ns, self._sources, self._move)
        self._now_ns += dt_ns

    def _move(self, from_ns: int, to_ns: int) -> None:
        sigma, rho = self._parameters.sigma, self._parameters.rho
        key = (self._mode.mode, sigma, rho)
        flow = self._flows.get(key)
        if flow is None:
            if self._plant.uncertainty == "sampled":
                self._flows.clear()
            flow = self._flows[key] = Flow(*self._plant.matrices(*key))
        span_ns = to_ns - from_ns
        # A whole sample period comes again and again; a piece between two random events does not.
        recurs = span_ns == self._step_ns and self._plant.uncertainty != "sampled"
        self._x = (flow.step if recurs else flow.drift)(self._x, self._v, span_ns)

    def measure(self) -> tuple[float, ...]:
        """Return x and the mode (1 or 2)."""
        return (*self._x, float(self._mode.mode))

    @property
    def state(self) -> tuple[float, ...]:
        """x, mode, and the true sigma and rho."""
        return (*self._x, float(self._mode.mode), self._parameters.sigma, self._parameters.rho)

    @property
    def applied(self) -> tuple[float, ...]:
        """The input of the last advance, without the disturbance."""
        return self._applied
