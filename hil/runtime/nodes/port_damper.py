"""The passivity controller at the rig: it observes what the motor gives, and takes it away by damping, or trips."""

from __future__ import annotations

import math
from typing import NamedTuple

from hil.rig.loop import Loop


class Injected(NamedTuple):
    """What the passivity controller saw and did in a slot.

    Attributes:
        energy: given beyond what damping takes, J; below 0 where the motor has taken more than it gave.
        damping: injected in this slot, force per speed.
        force: that comes of it, on top of the command.
    """

    energy: float
    damping: float
    force: float


class PortDamper:
    r"""Time-domain passivity observer and controller at the port of a device.

    .. math::
        E(k) = \sum_{j<k} (u_j - b w_j) (x_{j+1} - x_j), \quad w_j = (x_{j+1} - x_j)/T, \quad
        u_k = c_k - \min(E/(T w_{k-1}^2), a) w_{k-1} \text{ while } E > E_0

    The force is held over a slot, so that the first term is what the motor gave, exactly. Behind a controller that is certified
    passive with the damping b, E never exceeds 0 and the command stays as it is, bit for bit.

    Args:
        period_s: T, s.
        credit: b, the damping of device and hand.
        largest: a, the largest damping that is injected; 0 for none.
        allowed_j: E_0, J.
        trip_j: energy beyond which it trips, J; None for never.
        limit: largest magnitude of command and injected force together.

    Reference: Hannaford and Ryu, Time-domain passivity control of haptic interfaces, 2002; Chapter 6, (6.11).
    """

    def __init__(
        self, *, period_s: float, credit: float, largest: float, allowed_j: float, trip_j: float | None, limit: float
    ) -> None:
        self._period_s, self._credit, self._largest = period_s, credit, largest
        self._allowed_j, self._trip_j, self._limit = allowed_j, trip_j, limit
        self._before: float | None = None
        self._speed = 0.0
        self.energy_j = 0.0

    def observe(self, position: float, force: float) -> str | None:
        """Take the position that is reached in this slot; return the reason when it trips.

        Args:
            position: as measured at the device.
            force: what the motor put out since the position before.
        """
        before, self._before = self._before, position
        if before is None:
            return None
        moved = position - before
        self._speed = moved / self._period_s
        self.energy_j += moved * (force - self._credit * self._speed)
        if self._trip_j is not None and not self.energy_j <= self._trip_j:
            return f"passivity: the motor has given {self.energy_j:.4g} J more than the damping took, limit {self._trip_j:g} J"
        return None

    def damp(self, command: float) -> tuple[float, Injected]:
        """Return the force that is put out for a command that is within the limit, and what it has in it.

        Args:
            command: force that the controller asks for.
        """
        energy, speed = self.energy_j, self._speed
        if not energy > self._allowed_j or speed == 0.0 or not math.isfinite(speed):
            return command, Injected(energy, 0.0, 0.0)
        damping = min((energy - self._allowed_j) / (self._period_s * speed * speed), self._largest)
        damped = command - damping * speed
        put_out = min(max(damped, -self._limit), self._limit)
        if put_out != damped:
            damping = (command - put_out) / speed
        return put_out, Injected(energy, damping, put_out - command)


def damper_of(loop: Loop) -> PortDamper | None:
    """Return the passivity controller that an experiment asks for, None if it does not.

    Args:
        loop: the composed experiment.
    """
    asked, limits = loop.experiment.limits.passivity, loop.experiment.limits.input
    if asked is None or loop.rig.port is None:
        return None
    return PortDamper(
        period_s=loop.model.period_s, credit=loop.rig.port.damping, largest=asked.damping_n_s_per_m, allowed_j=asked.energy_j,
        trip_j=asked.trip_j, limit=math.inf if limits is None else limits[0],
    )  # fmt: skip
