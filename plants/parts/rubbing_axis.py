"""The motion of an axis with friction, exact through slip and stick.

Between two events (the speed reaches zero, or a corner of the friction curve) the motion is one exponential, and the
instant of the event has a closed form. So there is no step size, no tolerance, no smoothing of sign(v), and nothing to
chatter: at zero speed the body either sticks, which leaves the angle untouched to the last bit, or it leaves in the
direction of the drive.
"""

from __future__ import annotations

from bisect import bisect_right
from typing import Final

import numpy as np

from plants.parts import NS_PER_S, Matrix
from plants.parts.actuators import Friction
from plants.parts.exponential import log1p, log1p_many, phi, phi_many

FEW: Final = 24
"""Axes up to which one after the other is faster than all at once."""


class RubbingAxis:
    """Motion of an axis with friction under a held drive: angle' = v, v' = -pole v + gain (drive - F(v)).

    Args:
        gain: acceleration per volt, rad/s^2 per V.
        pole: viscous rate of the plant without the friction, 1/s.
        friction: the friction.

    Attributes:
        static_v: drive under which a body at rest stays at rest, V.
        corners: speeds at which the friction curve has its corners, rad/s, from 0.
        rates: v' = rates[i] v + gain (drive - levels[i]) from corner i on, 1/s.
        levels: V.
    """

    __slots__ = ("_gain", "corners", "levels", "rates", "static_v")

    def __init__(self, gain: float, pole: float, friction: Friction) -> None:
        self._gain = gain
        self.static_v = friction.breakaway_v
        speeds, values = friction.curve()
        slopes = [(f1 - f0) / (v1 - v0) for v0, v1, f0, f1 in zip(speeds, speeds[1:], values, values[1:])] + [0.0]
        damping = pole + gain * friction.viscous_v_s_per_rad
        self.corners = speeds
        self.rates = tuple(-damping - gain * s for s in slopes)
        # friction at speed v of cell i is levels[i] + slopes[i] v
        self.levels = tuple(f - s * v for f, s, v in zip(values, slopes, speeds))

    def move(self, angle: float, speed: float, drive: float, dt_s: float) -> tuple[float, float]:
        """Return angle (rad) and speed (rad/s) after dt_s of a held drive (V)."""
        left = dt_s
        while left > 0.0:
            if speed == 0.0:
                if abs(drive) <= self.static_v:
                    return angle, 0.0
                forward = drive > 0.0
            else:
                forward = speed > 0.0
            # The rest in the direction of motion: v >= 0 until the next event, then v' = rate v + c.
            v = abs(speed)
            push = drive if forward else -drive
            i = bisect_right(self.corners, v) - 1
            rate = self.rates[i]
            acceleration = rate * v + self._gain * (push - self.levels[i])
            if acceleration < 0.0 and v == self.corners[i] and i > 0:
                i -= 1
                rate = self.rates[i]
                acceleration = min(rate * v + self._gain * (push - self.levels[i]), 0.0)
            target: float | None = None
            if acceleration < 0.0:
                target = self.corners[i]
            elif acceleration > 0.0:
                if i + 1 < len(self.corners):
                    target = self.corners[i + 1]
            else:
                return angle + speed * left, speed  # friction and drive balance: the speed stays
            span = left
            arrived = False
            if target is not None:
                way = (target - v) / acceleration
                z = rate * way
                arrival = way if rate == 0.0 else log1p(z) / rate if z > -1.0 else left
                arrived = arrival < left
                if arrived:
                    span = arrival
            p1, p2 = phi(rate * span)
            travel = span * (v + acceleration * span * p2)
            if arrived and target is not None:
                v = target
            else:
                v += acceleration * span * p1
                if acceleration < 0.0 and v < self.corners[i]:  # by rounding, at most
                    v = self.corners[i]
            angle += travel if forward else -travel
            speed = v if forward or v == 0.0 else -v
            left -= span
        return angle, speed

    def hold(self, angle: float, speed: float, drive: float, dt_ns: int) -> tuple[float, float]:
        """Return angle (rad) and speed (rad/s) after dt_ns of a held drive (V)."""
        return self.move(angle, speed, drive, dt_ns / NS_PER_S)


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

    def hold(self, angle: Matrix, speed: Matrix, drive: Matrix, dt_ns: int) -> tuple[Matrix, Matrix]:
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
