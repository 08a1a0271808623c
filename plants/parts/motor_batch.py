"""Many running motors at once, each with bit for bit what one alone does."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final, Protocol

import numpy as np

from plants.parts.actuators import Driver, Friction
from plants.parts.exponential import log1p_many, phi_many, zero_order_hold
from plants.parts.linear import NS_PER_S, Matrix
from plants.parts.rubbing_axis import RubbingAxis

FEW: Final = 24
"""Axes up to which one after the other is faster than all at once."""


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


class RubbingAxes:
    """Axes of one kind, from event to event: those that have none left rest while the others go on.

    Each has bit for bit what `RubbingAxis` computes alone.

    Args:
        gain: acceleration per volt, rad/s^2 per V.
        pole: viscous rate of the plant without the friction, 1/s.
        friction: the friction.
    """

    def __init__(self, gain: float, pole: float, friction: Friction) -> None:
        one = RubbingAxis(gain, pole, friction)
        self._one, self._gain, self._static = one, gain, one.static_v
        self._corners, self._rates, self._levels = (np.array(values) for values in (one.corners, one.rates, one.levels))

    def move(self, angle: Matrix, speed: Matrix, drive: Matrix, dt_ns: int) -> tuple[Matrix, Matrix]:
        """Return angles (rad) and speeds (rad/s), (runs,), after dt_ns of held drives (V); NaN where it cannot be said."""
        angles, speeds = angle.copy(), speed.copy()
        left = dt_ns / NS_PER_S
        if not left > 0.0:
            return angles, speeds
        stuck = (speed == 0.0) & (np.abs(drive) <= self._static)
        speeds[stuck] = 0.0
        at = np.flatnonzero(~stuck)
        a, v, d, t = angle[at], speed[at], drive[at], np.full(at.size, left)
        while at.size:
            if at.size <= FEW:
                moves = [self._one.move(*each) for each in zip(a.tolist(), v.tolist(), d.tolist(), t.tolist(), strict=True)]
                angles[at], speeds[at] = np.array(moves).T
                break
            a, v, t = self._segment(a, v, d, t)
            angles[at], speeds[at] = a, v
            stuck = (v == 0.0) & (np.abs(d) <= self._static)
            speeds[at[stuck]] = 0.0
            on = np.flatnonzero((t > 0.0) & ~stuck)
            at, a, v, d, t = at[on], a[on], v[on], d[on], t[on]
        return angles, speeds

    def _segment(self, angle: Matrix, speed: Matrix, drive: Matrix, left: Matrix) -> tuple[Matrix, Matrix, Matrix]:
        """Move to the next event of each: angles, speeds and the time that is left then."""
        corners, gain = self._corners, self._gain
        forward = np.where(speed == 0.0, drive > 0.0, speed > 0.0)
        v, push = np.abs(speed), np.where(forward, drive, -drive)
        cell = np.searchsorted(corners, v, side="right") - 1
        rate = self._rates[cell]
        acceleration = rate * v + gain * (push - self._levels[cell])
        if corners.size > 1:
            back = (acceleration < 0.0) & (v == corners[cell]) & (cell > 0)
            cell = cell - back
            rate = self._rates[cell]
            lower = np.minimum(rate * v + gain * (push - self._levels[cell]), 0.0)
            acceleration = np.where(back, lower, acceleration)
        slower, faster = acceleration < 0.0, acceleration > 0.0
        bound = np.flatnonzero(slower | (faster & (cell + 1 < corners.size)))
        target = corners[np.minimum(cell + faster, corners.size - 1)]
        arrival = left.copy()
        if bound.size:
            arrival[bound] = _arrival(target[bound], v[bound], acceleration[bound], rate[bound], left[bound])
        arrived = arrival < left
        span = np.where(arrived, arrival, left)
        p1, p2 = phi_many(rate * span)
        travel = span * (v + acceleration * span * p2)
        reached = v + acceleration * span * p1
        floor = corners[cell]
        reached = np.where(slower & (reached < floor), floor, reached)
        reached = np.where(arrived, target, reached)
        steady = ~(slower | faster)
        angles = np.where(steady, angle + speed * left, angle + np.where(forward, travel, -travel))
        speeds = np.where(steady, speed, np.where(forward | (reached == 0.0), reached, -reached))
        return angles, speeds, np.where(steady, 0.0, left - span)


def _arrival(target: Matrix, speed: Matrix, acceleration: Matrix, rate: Matrix, left: Matrix) -> Matrix:
    """When the speeds reach their targets, s; `left` where they never do."""
    with np.errstate(all="ignore"):  # of what is not used
        way = (target - speed) / acceleration
        z = rate * way
        inside = z > -1.0
        return np.where(rate == 0.0, way, np.where(inside, log1p_many(np.where(inside, z, 0.0)) / rate, left))
