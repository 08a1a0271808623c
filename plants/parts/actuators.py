"""Actuators: what becomes of a commanded input before it reaches the plant."""

from __future__ import annotations

import math
from dataclasses import dataclass

from plants.errors import FieldError
from plants.parts.validation import require_not_negative, require_positive


@dataclass(frozen=True, slots=True, kw_only=True)
class Driver:
    """Voltage driver with supply saturation, PWM resolution and dead zone, in this order, each off by default.

    v = sat(u), rounded to the PWM's nearest duty, then shrunk: sign(v) max(|v| - dead_zone, 0).

    The dead zone is the offset form (output continuous in the input): with it the published steady-state errors of
    -0.0348 rad and 0.0172 rad (Remark 7.7) are what dead zone and stiction together leave.

    Args:
        saturation_v: largest magnitude of the output in V (the supply); None for no limit.
        pwm_step_v: voltage of one PWM count in V (supply over counts); 0 for continuous.
        dead_zone_v: voltage in V below which nothing moves; 0 for none.

    Raises:
        ValueError: where a parameter is negative or not finite, the saturation is 0, or a PWM count is more than it.

    >>> Driver(saturation_v=1.0, pwm_step_v=0.25, dead_zone_v=0.125).drive(0.6)
    0.375
    """

    saturation_v: float | None = None
    pwm_step_v: float = 0.0
    dead_zone_v: float = 0.0

    def __post_init__(self) -> None:
        if self.saturation_v is not None:
            require_positive("saturation_v", self.saturation_v)
        require_not_negative("pwm_step_v", self.pwm_step_v)
        require_not_negative("dead_zone_v", self.dead_zone_v)
        if self.saturation_v is not None and self.pwm_step_v > self.saturation_v:
            raise FieldError("pwm_step_v", f"{self.pwm_step_v:g} V is above the supply, saturation_v = {self.saturation_v:g} V")

    @property
    def ideal(self) -> bool:
        """Whether the output is the command itself."""
        return self.saturation_v is None and self.pwm_step_v == 0.0 and self.dead_zone_v == 0.0

    def drive(self, command_v: float) -> float:
        """Return the voltage that acts on the motor, in V."""
        v = command_v
        limit = self.saturation_v
        if limit is not None:
            v = limit if v > limit else -limit if v < -limit else v
        step = self.pwm_step_v
        if step and math.isfinite(v):
            size = step * math.floor(abs(v) / step + 0.5)
            if limit is not None and size > limit:  # a supply that is no whole number of counts
                size -= step
            v = size if v > 0.0 else -size if size else 0.0
        zone = self.dead_zone_v
        if zone:
            # a NaN passes through, for the rig to see
            v = v - zone if v > zone else v + zone if v < -zone else 0.0 if v == v else v
        return v
