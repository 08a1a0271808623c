"""The joint of the Phantom Omni haptic device, Chapter 6."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from plants.parts.linear import LinearRun, Signal, StateSpace
from plants.parts.validation import require_finite, require_not_negative, require_positive


@dataclass(frozen=True, slots=True, kw_only=True)
class Omni:
    """Bare joint of the haptic device: angle(s) = 1 / (s (m s + b)) torque(s).

    Args:
        inertia: m; 0.7943 as identified (printed in kg; in the transfer function it acts as kg m^2).
        damping: b; 1.9857 as identified (printed in N s/m; it acts as N m s/rad), at least 0.
        initial_angle_rad: angle at time 0 in rad.
        initial_speed_rad_s: speed at time 0 in rad/s.

    Raises:
        ValueError: where a parameter is out of range.

    Reference: thesis (6.1), (6.2).

    >>> Omni().model().A.tolist()[1][1] == -1.9857 / 0.7943
    True
    """

    inertia: float = 0.7943
    damping: float = 1.9857
    initial_angle_rad: float = 0.0
    initial_speed_rad_s: float = 0.0

    inputs: ClassVar[tuple[Signal, ...]] = (Signal("torque", "N m"),)
    outputs: ClassVar[tuple[Signal, ...]] = (Signal("angle", "rad"),)
    states: ClassVar[tuple[Signal, ...]] = (Signal("angle", "rad"), Signal("speed", "rad/s"))

    def __post_init__(self) -> None:
        require_positive("inertia", self.inertia)
        require_not_negative("damping", self.damping)
        require_finite("initial_angle_rad", self.initial_angle_rad)
        require_finite("initial_speed_rad_s", self.initial_speed_rad_s)

    def model(self) -> StateSpace:
        """Return the continuous-time model, state (angle, speed)."""
        return StateSpace(A=[[0.0, 1.0], [0.0, -self.damping / self.inertia]], B=[[0.0], [1.0 / self.inertia]], C=[[1.0, 0.0]])

    def start(self, rng: np.random.Generator) -> LinearRun:
        """Return the joint at time 0. It draws nothing from ``rng``."""
        return LinearRun(self.model(), (self.initial_angle_rad, self.initial_speed_rad_s))
