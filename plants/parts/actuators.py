"""What stands between a commanded input and a measured angle beside the motor itself: driver, friction, encoder."""

from __future__ import annotations

import math

from msgspec import Struct

from plants.errors import FieldError, require_not_negative, require_positive

_CHORDS = 24
_REACH = 3.0  # the Stribeck curve ends at 3 Stribeck speeds, where exp(-9) of it is left


class Driver(Struct, frozen=True, kw_only=True):
    """Voltage driver with supply saturation, PWM resolution and dead zone, in this order, each off by default.

    v = sat(u), rounded to the PWM's nearest duty, then shrunk: sign(v) max(|v| - dead_zone, 0).

    The dead zone is the offset form (output continuous in the input): with it the published steady-state errors of
    -0.0348 rad and 0.0172 rad (Remark 7.7) are what dead zone and stiction together leave.

    Args:
        saturation_v: largest magnitude of the output in V (the supply); by default no limit.
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


class Encoder(Struct, frozen=True, kw_only=True):
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


class Friction(Struct, frozen=True, kw_only=True):
    """Friction torque, in volts at the input that balance it.

    F(v) = sign(v) (coulomb + (static - coulomb) exp(-(v/stribeck_speed)^2)) + viscous v,  v != 0;
    at v = 0 the body sticks as long as |drive| <= static.

    The exponential is followed by 24 chords up to 3 Stribeck speeds (largest error 0.4 % of static - coulomb), which
    keeps every piece of the motion exact. Without a Stribeck speed the torque falls to the Coulomb value at once.

    Args:
        coulomb_v: sliding friction in V.
        static_v: break-away friction in V, at least coulomb_v; by default coulomb_v.
        stribeck_speed_rad_s: speed in rad/s over which static goes into Coulomb friction; 0 for at once.
        viscous_v_s_per_rad: friction in V per rad/s, in addition to the viscous part in the pole of the plant.

    Raises:
        ValueError: where a parameter is negative or not finite, or static_v is below coulomb_v.
    """

    coulomb_v: float = 0.0
    static_v: float | None = None
    stribeck_speed_rad_s: float = 0.0
    viscous_v_s_per_rad: float = 0.0

    def __post_init__(self) -> None:
        require_not_negative("coulomb_v", self.coulomb_v)
        require_not_negative("stribeck_speed_rad_s", self.stribeck_speed_rad_s)
        require_not_negative("viscous_v_s_per_rad", self.viscous_v_s_per_rad)
        if self.static_v is not None:
            require_not_negative("static_v", self.static_v)
            if self.static_v < self.coulomb_v:
                raise FieldError("static_v", f"{self.static_v!r}, expected at least coulomb_v ({self.coulomb_v!r})")

    @property
    def breakaway_v(self) -> float:
        """Largest drive in V under which a body at rest stays at rest."""
        return self.coulomb_v if self.static_v is None else self.static_v

    @property
    def dry(self) -> bool:
        """Whether there is any friction that does not vanish with the speed."""
        return self.breakaway_v > 0.0

    def curve(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Return speeds (rad/s, from 0) and dry friction (V) at the corners; constant after the last one."""
        excess, reach = self.breakaway_v - self.coulomb_v, self.stribeck_speed_rad_s * _REACH
        if excess == 0.0 or reach == 0.0:
            return (0.0,), (self.coulomb_v,)
        speeds = tuple(reach * i / _CHORDS for i in range(_CHORDS + 1))
        # exp(-x^2) with x = 3 i/24 = i/8, as a power of exp(-1/64), by products: libm's exp differs between machines
        base, decay, values = 0.9844964370054085, 1.0, [self.breakaway_v]
        for i in range(1, _CHORDS):
            for _ in range(2 * i - 1):
                decay *= base
            values.append(self.coulomb_v + excess * decay)
        return speeds, (*values, self.coulomb_v)
