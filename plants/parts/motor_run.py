"""The running DC motor: one step of a slot at a time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from plants.errors import PlantError
from plants.parts.exponential import zero_order_hold
from plants.parts.linear import NS_PER_S
from plants.parts.rubbing_axis import RubbingAxis

if TYPE_CHECKING:
    from plants.dc_motor import DCMotor


class _FreeAxis:
    """The axis without dry friction: one exact zero-order-hold step, computed once for every length."""

    __slots__ = ("_damping", "_dt_ns", "_gain", "_s00", "_s01", "_s10", "_s11")

    def __init__(self, gain: float, damping: float) -> None:
        self._gain, self._damping, self._dt_ns = gain, damping, 0
        self._s00 = self._s01 = self._s10 = 0.0
        self._s11 = 1.0

    def move(self, angle: float, speed: float, drive: float, dt_ns: int) -> tuple[float, float]:
        if dt_ns != self._dt_ns:
            self._tabulate(dt_ns)
        return angle + self._s00 * speed + self._s01 * drive, self._s11 * speed + self._s10 * drive

    def _tabulate(self, dt_ns: int) -> None:
        if dt_ns < 0:
            raise PlantError(f"advance: {dt_ns} ns, expected a time that does not run backwards")
        ratio = (dt_ns, NS_PER_S)
        Phi, Gamma = zero_order_hold([[0.0, 1.0], [0.0, -self._damping]], [[0.0], [self._gain]], ratio)
        self._s00, self._s11 = Phi[0][1], Phi[1][1]
        self._s01, self._s10 = Gamma[0][0], Gamma[1][0]
        self._dt_ns = dt_ns


class _DryAxis:
    """The axis with dry friction, on the nanosecond grid of the rig."""

    __slots__ = ("_rubbing",)

    def __init__(self, rubbing: RubbingAxis) -> None:
        self._rubbing = rubbing

    def move(self, angle: float, speed: float, drive: float, dt_ns: int) -> tuple[float, float]:
        return self._rubbing.move(angle, speed, drive, dt_ns / NS_PER_S)


class DCMotorRun:
    """The running motor. See `DCMotor` for the equations."""

    __slots__ = ("_angle", "_applied", "_axis", "_drive", "_now_ns", "_pieces", "_read", "_speed", "_tacho", "_through")

    def __init__(self, motor: DCMotor, before: DCMotorRun | None = None) -> None:
        damping = motor._damping
        self._axis = (
            _DryAxis(RubbingAxis(motor.gain, motor.pole, motor.friction))
            if motor.friction.dry
            else _FreeAxis(motor.gain, damping)
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
            self._angle, self._speed = self._axis.move(self._angle, self._speed, v, dt_ns)
            return
        for span_ns, load_v in self._pieces(self._now_ns, dt_ns):
            drive = v if load_v is None else v - load_v
            self._angle, self._speed = self._axis.move(self._angle, self._speed, drive, span_ns)
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
