"""The VTOL of Chapter 4: an actuator or sensors lose effect, and a fault detection process says so late, or wrongly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from plants.errors import FieldError, require_finite, require_not_negative, require_vector, require_whole_nanoseconds
from plants.parts import NS_PER_S, Signal, StateSpace
from plants.parts.exponential import Rows
from plants.parts.flow import Flow, HeldNoise, JumpProcess, Source, pass_time
from plants.parts.semi_markov import JumpModel, JumpRates, TransitionRates, check_mode
from plants.vtol import VTOL_INPUTS, VTOL_STATES, vtol_matrices


def _two_modes(nodes_s: tuple[float, ...], pairs: tuple[tuple[float, float], ...]) -> TransitionRates:
    return TransitionRates(nodes_s=nodes_s, rates=tuple(((-out, out), (back, -back)) for out, back in pairs))


# (4.28): lower, middle and upper bounds. Where in h they are reached is not printed; the nodes are an assumption.
_FAILURE = _two_modes((0.0, 1.0, 2.0), ((0.333, 0.1), (0.5, 0.118), (1.0, 0.143)))
_DETECTION = (
    _two_modes((0.0, 0.3, 0.6), ((1.0, 1.429), (1.538, 2.128), (3.333, 4.167))),
    _two_modes((0.0, 0.3, 0.6), ((0.833, 2.0), (1.176, 2.857), (2.0, 5.0))),
)


_ALL = (1.0, 1.0, 1.0, 1.0)
"""Sensors that show their states."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultyVTOL:
    """VTOL that fails: x' = A x + B_eta (u + w) + E omega; measured: S_eta x and the detected mode r.

    eta = 1 is the sound helicopter, eta = 2 has lost part of the effect of the first input on the vertical velocity, or part of
    what its sensors show, or both.
    r follows eta through rates that depend on it. The controller sees r only, and measures its own sojourn time; the log
    has both.

    Args:
        initial_state: horizontal and vertical velocity in knots, pitch rate in deg/s, pitch angle in deg.
        initial_fault: eta at time 0, 1 or 2.
        initial_detected: r at time 0, 1 or 2.
        fault_effectiveness: b21 of mode 2 over b21 of mode 1; 0.5 is the example.
        sensor_effectiveness: factors on the four measured states in mode 2; 0 is a sensor that is lost, 1 is the example.
        failure: rates of eta.
        detection: rates of r, one for every eta.
        failure_restarts_detection_clock: whether a jump of eta sets the sojourn clock of r to 0; the thesis does not say.
        noise_std: standard deviation of each sample of omega.
        noise_period_s: time over which a sample of omega is held, in s.

    Raises:
        ValueError: where a parameter is out of range.

    Reference: thesis sec. 4.4, (4.28), Remark 4.1.
    """

    initial_state: tuple[float, ...] = (0.1, 1.0, -0.2, -0.5)
    initial_fault: int = 1
    initial_detected: int = 1
    fault_effectiveness: float = 0.5
    sensor_effectiveness: tuple[float, ...] = (1.0, 1.0, 1.0, 1.0)
    failure: TransitionRates = _FAILURE
    detection: tuple[TransitionRates, ...] = _DETECTION
    failure_restarts_detection_clock: bool = False
    noise_std: float = 1.0
    noise_period_s: float = 0.01

    inputs: ClassVar[tuple[Signal, ...]] = VTOL_INPUTS
    outputs: ClassVar[tuple[Signal, ...]] = (*VTOL_STATES, Signal("detected_mode", "1"))
    states: ClassVar[tuple[Signal, ...]] = (*VTOL_STATES, Signal("fault_mode", "1"), Signal("detected_mode", "1"))
    tracked: ClassVar[tuple[str, ...]] = tuple(s.name for s in VTOL_STATES)

    def __post_init__(self) -> None:
        require_vector("initial_state", self.initial_state, 4)
        check_mode("initial_fault", self.initial_fault, 2)
        check_mode("initial_detected", self.initial_detected, 2)
        require_finite("fault_effectiveness", self.fault_effectiveness)
        require_vector("sensor_effectiveness", self.sensor_effectiveness, 4)
        if self.failure.modes != 2:
            raise FieldError("failure.rates", f"{self.failure.modes} modes, expected 2")
        if len(self.detection) != 2:
            raise FieldError("detection", f"{len(self.detection)} tables, expected one for each of 2 fault modes")
        for i, rates in enumerate(self.detection):
            if rates.modes != 2:
                raise FieldError(f"detection[{i}].rates", f"{rates.modes} modes, expected 2")
        require_not_negative("noise_std", self.noise_std)
        require_whole_nanoseconds("noise_period_s", self.noise_period_s)

    def matrices(self, fault: int) -> tuple[Rows, Rows, Rows]:
        """Return A (4 x 4), B (4 x 2) and E (4 x 2) of a fault mode (1 or 2)."""
        A, B = vtol_matrices(135)
        if fault == 2:
            B = (B[0], (self.fault_effectiveness * B[1][0], B[1][1]), *B[2:])
        return A, B, ((0.0, 0.1), (0.1, 0.0), (0.0, 0.0), (0.0, 0.0))

    def models(self) -> tuple[StateSpace, StateSpace]:
        """Return the models of both fault modes; the output's last entry, the detected mode, has a row of zeros."""
        C = np.eye(5, 4)
        first, second = (self.matrices(fault) for fault in (1, 2))
        return StateSpace(A=first[0], B=first[1], C=C), StateSpace(A=second[0], B=second[1], C=C * self.sensor_effectiveness)

    def model(self) -> StateSpace:
        """Return the model of the sound helicopter."""
        return self.models()[0]

    def jump_system(self) -> JumpModel:
        """Return both fault modes; w is omega, z the vertical velocity."""
        A, B, E = zip(*(self.matrices(fault) for fault in (1, 2)))
        shown = tuple(self.sensor_effectiveness)
        S = tuple(tuple(tuple(f if i == j else 0.0 for j in range(4)) for i, f in enumerate(each)) for each in (_ALL, shown))
        return JumpModel(A=A, B=B, E=E, C=(((0.0, 1.0, 0.0, 0.0),),) * 2, S=() if shown == _ALL else S)

    def jump_process(self) -> JumpRates:
        """Return the rates of the fault, and those of the detected mode, which alone is measured."""
        return JumpRates(
            rates=self.failure, detection=self.detection,
            failure_restarts_detection_clock=self.failure_restarts_detection_clock,
            initial=(self.initial_fault,), initial_detected=(self.initial_detected,),
        )  # fmt: skip

    def start(self, rng: np.random.Generator) -> FaultyVTOLRun:
        """Return the helicopter at time 0; faults, detection and noise are three streams spawned from ``rng``."""
        return FaultyVTOLRun(self, rng)


class _Failure:
    """eta, which takes the rates of r along when it jumps."""

    __slots__ = ("_detected", "_plant", "_process", "next_ns")

    def __init__(self, plant: FaultyVTOL, detected: JumpProcess, rng: np.random.Generator) -> None:
        self._plant, self._detected = plant, detected
        self._process = JumpProcess(plant.failure, plant.initial_fault, rng)
        self.next_ns = self._process.next_ns

    @property
    def mode(self) -> int:
        return self._process.mode

    def fire(self) -> None:
        now_ns = self.next_ns
        self._process.fire()
        self.next_ns = self._process.next_ns
        plant = self._plant
        rates = plant.detection[self.mode - 1]
        self._detected.change_rates(rates, now_ns, restart=plant.failure_restarts_detection_clock)


class FaultyVTOLRun:
    """The running helicopter. See `FaultyVTOL` for the equations."""

    __slots__ = (
        "_applied", "_detected", "_failure", "_flows", "_noise", "_now_ns", "_recurring", "_shown", "_sources", "_v", "_x",
    )  # fmt: skip

    def __init__(self, plant: FaultyVTOL, rng: np.random.Generator) -> None:
        failures, detections, noise = rng.spawn(3)
        period_ns = round(plant.noise_period_s * NS_PER_S)
        self._detected = JumpProcess(plant.detection[plant.initial_fault - 1], plant.initial_detected, detections)
        self._failure = _Failure(plant, self._detected, failures)
        self._noise = HeldNoise(2, plant.noise_std, period_ns, noise)
        # At one instant detection goes first: it knew nothing of a failure that comes at the same time.
        self._sources: tuple[Source, ...] = (self._detected, self._failure, self._noise)
        self._flows = []
        for fault in (1, 2):
            A, B, E = plant.matrices(fault)
            self._flows.append(Flow(A, [(*b, *e) for b, e in zip(B, E)]))
        self._shown = tuple(float(factor) for factor in plant.sensor_effectiveness)
        self._x = [float(x) for x in plant.initial_state]
        self._applied: tuple[float, ...] = (0.0, 0.0)
        self._v: tuple[float, ...] = (0.0, 0.0)
        self._now_ns = 0
        self._recurring: set[int] = set()
        self._expect(period_ns)

    def advance(self, dt_ns: int, u: Sequence[float], w: Sequence[float] = ()) -> None:
        """Hold u + w for dt_ns, through every jump and every noise sample that falls into it."""
        self._applied = tuple(u)
        self._v = tuple(a + b for a, b in zip(u, w)) if w else self._applied
        if dt_ns not in self._recurring and len(self._recurring) < 4:
            self._expect(dt_ns)
        pass_time(self._now_ns, self._now_ns + dt_ns, self._sources, self._move)
        self._now_ns += dt_ns

    def _expect(self, dt_ns: int) -> None:
        self._recurring.add(dt_ns)
        for flow in self._flows:
            flow.prepare(dt_ns)

    def _move(self, from_ns: int, to_ns: int) -> None:
        flow = self._flows[self._failure.mode - 1]
        span_ns = to_ns - from_ns
        # A whole period comes again and again; a piece between two random events does not.
        move = flow.step if span_ns in self._recurring else flow.drift
        self._x = move(self._x, (*self._v, *self._noise.values), span_ns)

    def measure(self) -> tuple[float, ...]:
        """Return what the sensors show of x, and the detected mode r (1 or 2)."""
        if self._failure.mode == 1:
            return (*self._x, float(self._detected.mode))
        return (*(x * factor for x, factor in zip(self._x, self._shown)), float(self._detected.mode))

    @property
    def state(self) -> tuple[float, ...]:
        """x, the true fault mode eta, and the detected mode r."""
        return (*self._x, float(self._failure.mode), float(self._detected.mode))

    @property
    def applied(self) -> tuple[float, ...]:
        """The input of the last advance, without the disturbance."""
        return self._applied
