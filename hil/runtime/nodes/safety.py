"""Safety at the rig: limits and watchdog, latched, whatever the controller does."""

from __future__ import annotations

from collections.abc import Sequence
from math import isinf, isnan


class Safety:
    """Decides, slot by slot, whether the rig may go on.

    Once tripped it stays tripped: the rig applies zero input until the end of the run.

    Args:
        input_limits: sequence of float or None, length m. Largest absolute command per input.
        state_limits: (index, name, bound) each. Largest absolute value of plant states.
        watchdog_slots: slots in a row without a usable command that trip the watchdog.
        period_ns: sample period, ns: as many periods trip it too where slots take longer.
    """

    def __init__(
        self,
        input_limits: Sequence[float] | None,
        state_limits: Sequence[tuple[int, str, float]],
        watchdog_slots: int,
        period_ns: int = 0,
    ) -> None:
        self._inputs = input_limits
        self._states = state_limits
        self._watchdog_slots = watchdog_slots
        self._watchdog_ns = (watchdog_slots - 1) * period_ns
        self._missing = self._since_ns = 0
        self.tripped: str | None = None

    def check_state(self, state: Sequence[float]) -> str | None:
        """Trip on a state beyond its bound or not finite; return the reason when this call trips."""
        if self.tripped is None:
            for i, name, bound in self._states:
                if not -bound <= state[i] <= bound:
                    return self.trip(f"{name} = {state[i]:.4g} is beyond its limit {bound:g}")
            total = 0.0
            for value in state:
                total += value
            if isinf(total) or isnan(total):
                return self.trip("the plant's state is not finite")
        return None

    def check_command(self, u: Sequence[float]) -> str | None:
        """Trip on a command beyond its bound; return the reason when this call trips. Any other command feeds the watchdog."""
        if self.tripped is None and self._inputs is not None:
            for value, bound in zip(u, self._inputs):
                if abs(value) > bound:
                    return self.trip(self._beyond(u))
        self._missing = 0
        return None

    def _beyond(self, u: Sequence[float]) -> str:
        wrong = ((i, value, bound) for i, (value, bound) in enumerate(zip(u, self._inputs or ())) if abs(value) > bound)
        return "command {} = {:.4g} is beyond its limit {:g}".format(*next(wrong))

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
