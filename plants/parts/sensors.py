"""Sensors: what a rig measures of a state."""

from __future__ import annotations

import math
from dataclasses import dataclass

from plants.parts.validation import require_not_negative


@dataclass(frozen=True, slots=True, kw_only=True)
class Encoder:
    """Incremental encoder: y = step * floor(angle / step + 1/2), the multiple of the step that is nearest.

    Args:
        step_rad: angle of one count in rad (2 pi over the counts per turn); 0 measures the angle itself.

    Raises:
        ValueError: where the step is negative or not finite.

    >>> Encoder(step_rad=0.5).read(0.8)
    1.0
    """

    step_rad: float = 0.0

    def __post_init__(self) -> None:
        require_not_negative("step_rad", self.step_rad)

    def read(self, angle_rad: float) -> float:
        """Return the measured angle in rad."""
        if self.step_rad == 0.0 or not math.isfinite(angle_rad):
            return angle_rad
        return self.step_rad * math.floor(angle_rad / self.step_rad + 0.5)
