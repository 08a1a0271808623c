"""Many axes with friction at once, each with bit for bit what one alone does."""

from __future__ import annotations

import numpy as np

from plants.parts.exponential import log1p_many, phi_many
from plants.parts.friction import Friction
from plants.parts.linear import NS_PER_S, Matrix
from plants.parts.rubbing_axis import RubbingAxis

FEW = 24
"""Axes up to which one after the other is faster than all at once."""


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
