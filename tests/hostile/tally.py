"""What became of hostile inputs: read, refused with one message, or a failure."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hil.cli.terminal import LONGEST, message_lines
from tests.hostile.watchdog import WORK_S, Hangs, within

MOST_MB = 300
"""Memory that the inputs of a test may take beyond what was there."""

Note = Callable[[str, object], None]


def _memory_kb(what: str) -> int:
    status = Path("/proc/self/status").read_text()
    return int(status.partition(f"{what}:")[2].split()[0])


class Tally:
    """Tries inputs at one boundary, counts them, and keeps the first of each kind of failure.

    Args:
        boundary: its name.
        refusals: what may be raised.
        work_s: CPU time after which an input hangs, s.
    """

    def __init__(self, boundary: str, refusals: tuple[type[Exception], ...], work_s: float = WORK_S) -> None:
        self.boundary, self._refusals, self._work_s = boundary, refusals, work_s
        self.read = self.refused = 0
        self._failures: dict[tuple[str, str], str] = {}
        Path("/proc/self/clear_refs").write_text("5")  # the peak is what it is now
        self._before_kb = _memory_kb("VmRSS")

    def attack(self, attempt: Callable[[], object], data: Any) -> None:
        """Try one input; any exception but a refusal is a failure, and so are a hang and a message without end."""
        try:
            with within(self._work_s):
                read = attempt()
        except self._refusals as error:
            self.refused += 1
            if sum(len(line.encode()) + 6 for line in message_lines(str(error))) > LONGEST:
                self._fail("message", "", f"{str(error)[:200]!r} for {data!r:.500}")
        except (Exception, Hangs) as error:
            at = traceback.extract_tb(error.__traceback__)
            own = [frame for frame in at if "/tests/" not in frame.filename] or at
            reported = f"{error!r:.300}\nfor {data!r:.1500}\n{''.join(traceback.format_list(own[-3:]))}"
            self._fail(type(error).__name__, f"{own[-1].filename}:{own[-1].lineno}", reported)
        else:
            self.read += read is not False
            self.refused += read is False

    def _fail(self, kind: str, where: str, reported: str) -> None:
        self._failures.setdefault((kind, where), f"{self.boundary}: {reported}")

    def end(self, note: Note) -> None:
        """Note the counts, and fail if anything did."""
        for name in ("boundary", "read", "refused"):
            note(name, getattr(self, name))
        grown_mb = (_memory_kb("VmHWM") - self._before_kb) / 1e3
        assert not self._failures, "\n\n".join(self._failures.values())
        assert grown_mb < MOST_MB, f"{self.boundary}: {grown_mb:.0f} MB for inputs of some kilobytes"
