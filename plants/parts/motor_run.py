"""The running DC motor, one step of a slot at a time: alone, and many at once, each with bit for bit what one alone does."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from plants.errors import PlantError
from plants.parts import NS_PER_S, Matrix
from plants.parts.actuators import Driver
from plants.parts.exponential import zero_order_hold
from plants.parts.rubbing_axis import RubbingAxes, RubbingAxis

if TYPE_CHECKING:
    from plants.dc_motor import DCMotor

Held = tuple[float, float, float, float]


def _held(gain: float, damping: float, dt_ns: int) -> Held:
    """The step of an axis without dry friction: angle + a speed + b drive and c speed + d drive, exactly; a, b, c, d."""
    if dt_ns < 0:
        raise PlantError(f"advance: {dt_ns} ns, expected a time that does not run backwards")
    Phi, Gamma = zero_order_hold([[0.0, 1.0], [0.0, -damping]], [[0.0], [gain]], (dt_ns, NS_PER_S))
    return Phi[0][1], Gamma[0][0], Phi[1][1], Gamma[1][0]


class _FreeAxis:
    """The axis without dry friction; its step is computed once for every length. Compiled, one class for many too is slower."""

    __slots__ = ("_damping", "_dt_ns", "_gain", "_step")

    def __init__(self, gain: float, damping: float) -> None:
        self._gain, self._damping, self._dt_ns = gain, damping, 0
        self._step: Held = (0.0, 0.0, 1.0, 0.0)

    def hold(self, angle: float, speed: float, drive: float, dt_ns: int) -> tuple[float, float]:
        if dt_ns != self._dt_ns:
            self._step, self._dt_ns = _held(self._gain, self._damping, dt_ns), dt_ns
        a, b, c, d = self._step
        return angle + a * speed + b * drive, c * speed + d * drive


class FreeAxes:
    """Axes without dry friction, angle' = speed, speed' = -damping speed + gain drive.

    Args:
        gain: acceleration per volt in rad/s^2 per V.
        damping: viscous rate in 1/s.
    """

    def __init__(self, gain: float, damping: float) -> None:
        self._gain, self._damping, self._dt_ns = gain, damping, 0
        self._step: Held = (0.0, 0.0, 1.0, 0.0)

    def hold(self, angle: Matrix, speed: Matrix, drive: Matrix, dt_ns: int) -> tuple[Matrix, Matrix]:
        """Return angles (rad) and speeds (rad/s), (runs,), after dt_ns of held drives (V)."""
        if dt_ns != self._dt_ns:
            self._step, self._dt_ns = _held(self._gain, self._damping, dt_ns), dt_ns
        a, b, c, d = self._step
        return angle + a * speed + b * drive, c * speed + d * drive


class DCMotorRun:
    """The running motor. See `DCMotor` for the equations."""

    __slots__ = ("_angle", "_applied", "_axis", "_drive", "_now_ns", "_pieces", "_read", "_speed", "_tacho", "_through")

    def __init__(self, motor: DCMotor, before: DCMotorRun | None = None) -> None:
        self._axis = (
            RubbingAxis(motor.gain, motor.pole, motor.friction) if motor.friction.dry else _FreeAxis(motor.gain, motor.damping)
        )
        self._drive = None if motor.driver.ideal else motor.driver.drive
        self._through = motor.disturbance_through_driver
        self._read = motor.encoder.read if motor.encoder.step_rad else None
        self._pieces = motor.load.pieces if motor.load.torque_v else None
        self._tacho = motor.tachometer
        self._now_ns = 0
        self._angle, self._speed = float(motor.initial_angle_rad), float(motor.initial_speed_rad_s)
        self._applied = 0.0
        if before is not None:
            self._now_ns, self._applied = before._now_ns, before._applied
            self._angle, self._speed = before._angle, before._speed

    def advance(self, dt_ns: int, u: Sequence[float], w: Sequence[float] = ()) -> None:
        """Hold the command for dt_ns.

        Args:
            dt_ns: time in nanoseconds, at least 0.
            u: commanded voltage in V, one entry.
            w: disturbance in V, added where `DCMotor.disturbance_through_driver` says, one entry or nothing.
        """
        if self._drive is None:
            self._applied = v = u[0]
            if w:
                v += w[0]
        elif w and self._through:
            self._applied = v = self._drive(u[0] + w[0])
        else:
            self._applied = v = self._drive(u[0])
            if w:
                v += w[0]
        if self._pieces is None:
            self._angle, self._speed = self._axis.hold(self._angle, self._speed, v, dt_ns)
            return
        for span_ns, load_v in self._pieces(self._now_ns, dt_ns):
            drive = v if load_v is None else v - load_v
            self._angle, self._speed = self._axis.hold(self._angle, self._speed, drive, span_ns)
        self._now_ns += dt_ns

    def measure(self) -> tuple[float, ...]:
        """Return the angle in rad as the encoder gives it, and with a tachometer the speed in rad/s."""
        angle = self._angle if self._read is None else self._read(self._angle)
        return (angle, self._speed) if self._tacho else (angle,)

    @property
    def state(self) -> tuple[float, ...]:
        """Angle in rad and speed in rad/s, the true ones."""
        return (self._angle, self._speed)

    @property
    def applied(self) -> tuple[float, ...]:
        """Voltage that the driver put out in the last advance (behind it no disturbance and no load is counted)."""
        return (self._applied,)


class MotorRuns:
    """Running motors: an axis under driver(u) + w - load, y = encoder(angle).

    Each run has bit for bit what `DCMotorRun` computes alone.

    Args:
        motor: its parameters.
        runs: how many.
    """

    def __init__(self, motor: DCMotor, runs: int) -> None:
        self._axes = (
            RubbingAxes(motor.gain, motor.pole, motor.friction) if motor.friction.dry else FreeAxes(motor.gain, motor.damping)
        )
        self._driver, self._through = None if motor.driver.ideal else motor.driver, motor.disturbance_through_driver
        self._step_rad, self._tachometer = motor.encoder.step_rad, motor.tachometer
        self._pieces, self._now_ns = motor.load.pieces, 0
        start = np.array([motor.initial_angle_rad, motor.initial_speed_rad_s], dtype=np.float64)
        self.state: Matrix = np.repeat(start[:, None], runs, axis=1)

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
            self.state = np.stack(self._axes.hold(angle, speed, v if load_v is None else v - load_v, span_ns))
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
