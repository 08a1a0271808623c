"""The VTOL of Chapter 3: airspeeds that change at random, and a state delay that changes all the time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from plants.errors import (
    FieldError,
    require_finite,
    require_not_negative,
    require_positive,
    require_vector,
    require_whole_nanoseconds,
)
from plants.parts import Signal, StateSpace
from plants.parts.delayed_run import DelayedVTOLRun
from plants.parts.semi_markov import JumpModel, JumpRates, TransitionRates, check_mode
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
        return JumpRates(rates=self.rates, initial=(self.initial_mode,))

    def start(self, rng: np.random.Generator) -> DelayedVTOLRun:
        """Return the helicopter at time 0; jumps and noise are drawn from two streams spawned from ``rng``."""
        return DelayedVTOLRun(self, [vtol_matrices(airspeed) for airspeed in AIRSPEEDS_KN], rng)
