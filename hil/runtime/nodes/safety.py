"""Safety at the rig, whatever the controller does: limits and a watchdog, latched, and a passivity controller at a port.

The passivity controller observes what the motor gives, and takes it away by damping, or trips.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import inf, isfinite, isinf, isnan
from typing import NamedTuple

from hil.rig.loop import Loop
from plants import Signal


class Safety:
    """Decides, slot by slot, whether the rig may go on.

    Once tripped it stays tripped: the rig applies zero input until the end of the run.

    Args:
        input_limits: sequence of float or None, length m. Largest absolute command per input.
        state_limits: (index, signal, bound) each. Largest absolute value of plant states.
        watchdog_slots: slots in a row without a usable command that trip the watchdog.
        period_ns: sample period, ns: as many periods trip it too where slots take longer.
        inputs: names and units, length m, for the reason in words.
    """

    def __init__(
        self,
        input_limits: Sequence[float] | None,
        state_limits: Sequence[tuple[int, Signal, float]],
        watchdog_slots: int,
        period_ns: int = 0,
        inputs: Sequence[Signal] = (),
    ) -> None:
        self._inputs = input_limits
        self._signals = inputs
        self._states = state_limits
        self._watchdog_slots = watchdog_slots
        self._watchdog_ns = (watchdog_slots - 1) * period_ns
        self._missing = self._since_ns = 0
        self.tripped: str | None = None

    def check_state(self, state: Sequence[float]) -> str | None:
        """Trip on a state beyond its bound or not finite; return the reason when this call trips."""
        if self.tripped is None:
            for i, signal, bound in self._states:
                if not -bound <= state[i] <= bound:
                    return self.trip(_beyond(signal, state[i], bound))
            total = 0.0
            for value in state:
                total += value
            if isinf(total) or isnan(total):
                return self.trip("the plant's state is not finite")
        return None

    def check_command(self, u: Sequence[float]) -> str | None:
        """Trip on a command beyond its bound; return the reason when this call trips. Any other command feeds the watchdog."""
        if self.tripped is None and self._inputs is not None:
            for i, bound in enumerate(self._inputs):
                if abs(u[i]) > bound:
                    return self.trip(f"command {_beyond(self._signals[i], u[i], bound)}")
        self._missing = 0
        return None

    def starved(self, now_ns: int = 0) -> str | None:
        """No usable command in this slot; return the reason when this trips the watchdog, by slots or by the clock.

        Args:
            now_ns: when the slot began, ns.
        """
        self._missing += 1
        if self._missing == 1:
            self._since_ns = now_ns
        if self.tripped is None and self._missing >= self._watchdog_slots:
            return self.trip(f"watchdog: {self._missing} slots in a row without a usable command")
        passed_ns = now_ns - self._since_ns
        if self.tripped is None and 0 < self._watchdog_ns <= passed_ns:
            return self.trip(f"watchdog: {passed_ns / 1e6:.4g} ms ({self._missing} slots) without a usable command")
        return None

    def trip(self, reason: str) -> str | None:
        """Latch the safe state for a reason; return it if nothing tripped before.

        Args:
            reason: in words.
        """
        if self.tripped is not None:
            return None
        self.tripped = reason
        return reason


def _beyond(signal: Signal, value: float, bound: float) -> str:
    unit = "" if signal.unit in ("", "1") else f" {signal.unit}"
    return f"{signal.name} = {value:.4g}{unit} is beyond its limit {bound:g}{unit}"


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
        if not energy > self._allowed_j or speed == 0.0 or not isfinite(speed):
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
        trip_j=asked.trip_j, limit=inf if limits is None else limits[0],
    )  # fmt: skip
