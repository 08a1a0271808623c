"""Actuators and sensors: what becomes of a commanded input before it reaches the plant, and what a rig measures of a state."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np
from msgspec import Struct

from plants.errors import FieldError, require_not_negative, require_positive
from plants.parts.exponential import zero_order_hold
from plants.parts.linear import NS_PER_S, Matrix


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


class Axes(Protocol):
    """Axes of one kind in many runs."""

    def move(self, angle: Matrix, speed: Matrix, drive: Matrix, dt_ns: int) -> tuple[Matrix, Matrix]:
        """Return angles (rad) and speeds (rad/s), (runs,), after dt_ns of held drives (V)."""
        ...


class FreeAxes:
    """Axes without dry friction, angle' = speed, speed' = -damping speed + gain drive: one exact step for every length.

    Args:
        gain: acceleration per volt in rad/s^2 per V.
        damping: viscous rate in 1/s.
    """

    def __init__(self, gain: float, damping: float) -> None:
        self._gain, self._damping = gain, damping
        self._held: dict[int, tuple[float, float, float, float]] = {}

    def move(self, angle: Matrix, speed: Matrix, drive: Matrix, dt_ns: int) -> tuple[Matrix, Matrix]:
        """See `Axes`."""
        found = self._held.get(dt_ns)
        if found is None:
            Phi, Gamma = zero_order_hold([[0.0, 1.0], [0.0, -self._damping]], [[0.0], [self._gain]], (dt_ns, NS_PER_S))
            found = self._held[dt_ns] = (Phi[0][1], Gamma[0][0], Phi[1][1], Gamma[1][0])
        a, b, c, d = found
        return angle + a * speed + b * drive, c * speed + d * drive


class MotorRuns:
    """Running motors: an axis under driver(u) + w - load, y = encoder(angle).

    Each run has bit for bit what `DCMotorRun` computes alone.

    Args:
        axes: what the drive moves.
        start: angle in rad and speed in rad/s of every run at time 0.
        driver: what becomes of a command; None for nothing.
        through: whether w is added to the command, before the driver.
        encoder_step_rad: angle of one count in rad, 0 for none.
        tachometer: whether the speed is measured too.
        pieces: of a slot: (length in ns, load in V) of every part of constant load from one instant over some time, both in ns.
        runs: how many.
    """

    def __init__(
        self, axes: Axes, start: tuple[float, float], *, driver: Driver | None, through: bool, encoder_step_rad: float,
        tachometer: bool, pieces: Callable[[int, int], list[tuple[int, float | None]]], runs: int,
    ) -> None:  # fmt: skip
        self._axes, self._driver, self._through = axes, driver, through
        self._step_rad, self._pieces, self._now_ns = encoder_step_rad, pieces, 0
        self._tachometer = tachometer
        self.state: Matrix = np.repeat(np.array(start, dtype=np.float64)[:, None], runs, axis=1)

    def advance(self, dt_ns: int, u: Matrix, w: Sequence[float]) -> None:
        """Hold the commands u (1, runs) and the disturbance w (1,) for dt_ns."""
        if self._driver is None:
            v = u[0] + w[0]
        elif self._through:
            v = drive_many(self._driver, u[0] + w[0])
        else:
            v = drive_many(self._driver, u[0]) + w[0]
        for span_ns, load_v in self._pieces(self._now_ns, dt_ns):
            angle, speed = self.state
            self.state = np.stack(self._axes.move(angle, speed, v if load_v is None else v - load_v, span_ns))
        self._now_ns += dt_ns

    def measure(self) -> Matrix:
        """Return the angle in rad as the encoder gives it, and with a tachometer the speed, (1 or 2, runs)."""
        angle, step = self.state[:1], self._step_rad
        read = step * np.floor(angle / step + 0.5) if step else angle
        return np.concatenate((read, self.state[1:])) if self._tachometer else read


def drive_many(driver: Driver, command_v: Matrix) -> Matrix:
    """Return what `Driver.drive` gives for every command, in V, shape as the commands."""
    v, limit, step, zone = command_v, driver.saturation_v, driver.pwm_step_v, driver.dead_zone_v
    if limit is not None:
        v = np.where(v > limit, limit, np.where(v < -limit, -limit, v))
    if step:
        size = step * np.floor(np.abs(v) / step + 0.5)
        if limit is not None:
            size = np.where(size > limit, size - step, size)
        v = np.where(v > 0.0, size, np.where(size != 0.0, -size, 0.0))
    if zone:
        v = np.where(v > zone, v - zone, np.where(v < -zone, v + zone, 0.0))
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
