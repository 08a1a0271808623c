"""The VTOL helicopter of Chapters 3, 4 and 7: its matrices, the rig of Section 7.4.1, and the plant of Chapter 3.

In Chapter 3 airspeeds change at random, and a state delay changes all the time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

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
from plants.parts.exponential import Rows
from plants.parts.linear_run import LinearRun, LinearRuns
from plants.parts.semi_markov import JumpModel, JumpRates, TransitionRates, check_mode

if TYPE_CHECKING:
    from plants.parts.delayed_run import DelayedVTOLRun

VTOL_STATES = (
    Signal("horizontal_velocity", "kn"),
    Signal("vertical_velocity", "kn"),
    Signal("pitch_rate", "deg/s"),
    Signal("pitch_angle", "deg"),
)
# The thesis and [102] give the inputs no unit.
VTOL_INPUTS = (Signal("collective_pitch", "1"), Signal("longitudinal_cyclic_pitch", "1"))

# Table 3.1: airspeed in knots -> a32, a34, b21, in the order of the modes
AIRSPEEDS_KN = (135, 60, 170)
_BY_AIRSPEED = {135: (0.3681, 1.4200, 3.5446), 60: (0.0664, 0.1198, 0.9775), 170: (0.5047, 2.5460, 5.1120)}


def vtol_matrices(airspeed_kn: int) -> tuple[Rows, Rows]:
    """Return A (4 x 4) and B (4 x 2) of the VTOL at one of the three airspeeds of Table 3.1, in knots.

    Raises:
        KeyError: for any other airspeed.

    Reference: thesis sec. 3.4; K. S. Narendra and S. S. Tripathi, J. Aircraft 10 (1973).
    """
    a32, a34, b21 = _BY_AIRSPEED[airspeed_kn]
    A = (
        (-0.0366, 0.0271, 0.0188, -0.4555),
        (0.0482, -1.0100, 0.0024, -4.0208),
        (0.1002, a32, -0.707, a34),
        (0.0, 0.0, 1.0, 0.0),
    )
    B = ((0.4422, 0.1761), (b21, -7.5922), (-5.5200, 4.4900), (0.0, 0.0))
    return A, B


@dataclass(frozen=True, slots=True, kw_only=True)
class VTOL:
    """VTOL helicopter in hover: x' = A x + B (u + w), y = vertical velocity. Unstable without control.

    The printed discrete matrices of sec. 7.4.1 are the zero-order hold of this model at 0.01 s and 135 knots.

    Args:
        airspeed_kn: 60, 135 or 170 knots (Table 3.1).
        initial_state: horizontal and vertical velocity in knots, pitch rate in deg/s, pitch angle in deg.

    Raises:
        ValueError: where the airspeed is not in the table or the state is not four finite numbers.

    Reference: thesis sec. 7.4.1 and 3.4.

    >>> run = VTOL().start(np.random.default_rng(0))
    >>> run.advance(10_000_000, (1.0, 0.0))
    >>> round(run.measure()[0], 4)
    0.0353
    """

    airspeed_kn: int = 135
    initial_state: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)

    inputs: ClassVar[tuple[Signal, ...]] = VTOL_INPUTS
    outputs: ClassVar[tuple[Signal, ...]] = (VTOL_STATES[1],)
    states: ClassVar[tuple[Signal, ...]] = VTOL_STATES

    def __post_init__(self) -> None:
        if self.airspeed_kn not in AIRSPEEDS_KN:
            raise FieldError("airspeed_kn", f"{self.airspeed_kn!r}, expected one of 60, 135, 170")
        require_vector("initial_state", self.initial_state, 4)

    def model(self) -> StateSpace:
        """Return the continuous-time model, with the vertical velocity as the output."""
        A, B = vtol_matrices(self.airspeed_kn)
        return StateSpace(A=A, B=B, C=[[0.0, 1.0, 0.0, 0.0]])

    def start(self, rng: np.random.Generator) -> LinearRun:
        """Return the helicopter at time 0. It draws nothing from ``rng``."""
        return LinearRun(self.model(), self.initial_state)

    def start_batch(self, runs: int) -> LinearRuns:
        """Return so many of them at time 0."""
        return LinearRuns(self.model(), self.initial_state, runs)


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
        from plants.parts.delayed_run import DelayedVTOLRun  # the VTOL without delay does without

        return DelayedVTOLRun(self, [vtol_matrices(airspeed) for airspeed in AIRSPEEDS_KN], rng)
