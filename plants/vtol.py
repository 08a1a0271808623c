"""The VTOL helicopter of Chapters 3, 4 and 7: its matrices, and the rig of Section 7.4.1."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from plants.errors import FieldError, require_vector
from plants.parts import Signal, StateSpace
from plants.parts.exponential import Rows
from plants.parts.linear_run import LinearRun, LinearRuns

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
