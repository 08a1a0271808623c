"""The motion of an axis with friction, exact through slip and stick.

Between two events (the speed reaches zero, or a corner of the friction curve) the motion is one exponential, and the
instant of the event has a closed form. So there is no step size, no tolerance, no smoothing of sign(v), and nothing to
chatter: at zero speed the body either sticks, which leaves the angle untouched to the last bit, or it leaves in the
direction of the drive.
"""

from __future__ import annotations

from bisect import bisect_right

from plants.parts.actuators import Friction
from plants.parts.exponential import log1p, phi


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
