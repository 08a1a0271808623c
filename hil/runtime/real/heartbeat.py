"""The time-out of the rig process: whether it still lives, judged by its records."""

from __future__ import annotations

from typing import Final

SHORTEST_S: Final = 1.0
PERIODS: Final = 50
PATIENCE: Final = 10
"""A rig that is not stopped may be silent this many times longer: a busy machine may keep it from a CPU for seconds."""

START_S: Final = 30.0
_LONGEST_LOOK_S: Final = 0.1


class HeartbeatTimeout:
    """Measures for how long no record has come, and gives the rig up after a bounded time.

    Time in which this process itself did not run (it was stopped, or the machine slept) counts as `_LONGEST_LOOK_S` at most: the
    records of that time still lie in the pipe.

    Args:
        period_s: sample period, s: every slot leaves records.
        hello_s: how long the rig waits for a controller before its first record, s.
    """

    def __init__(self, period_s: float, hello_s: float) -> None:
        self.stopped_s = max(SHORTEST_S, PERIODS * period_s)
        self.silent_s = PATIENCE * self.stopped_s
        self._start_s = hello_s + START_S
        self._looked_ns: int | None = None
        self._records = 0
        self._quiet_s = self._stopped_for_s = 0.0

    def look(self, now_ns: int, records: int, stopped: bool) -> str | None:
        """Return why the rig is given up, None while it need not be.

        Args:
            now_ns: a monotonic clock, ns.
            records: records that have come so far.
            stopped: whether the rig's process is stopped now.
        """
        passed = 0.0 if self._looked_ns is None else min((now_ns - self._looked_ns) / 1e9, _LONGEST_LOOK_S)
        self._looked_ns = now_ns
        if records != self._records:
            self._records, self._quiet_s = records, 0.0
        else:
            self._quiet_s += passed
        self._stopped_for_s = self._stopped_for_s + passed if stopped else 0.0
        if min(self._stopped_for_s, self._quiet_s) >= self.stopped_s:
            return f"the rig process is stopped (SIGSTOP): no record came for {self.stopped_s:g} s"
        limit_s = self.silent_s if records else max(self.silent_s, self._start_s)
        if self._quiet_s >= limit_s:
            return f"the rig process is alive and silent: no record came for {limit_s:g} s"
        return None
