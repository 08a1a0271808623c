"""A command in a process of its own: its time and its memory."""

from __future__ import annotations

import os
import re
import subprocess
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Final, NamedTuple

from hil.errors import HilError
from hil.runtime.real.child import PYTHON

HIL: Final = (*PYTHON, "-m", "hil")
NUMPY: Final = (*PYTHON, "-c", "import numpy")
"""The least that a command of ours has to start: what the start of every one is set beside."""

_LOOK_S: Final = 0.01
_PEAK: Final = re.compile(r"^VmHWM:\s*(\d+) kB", re.MULTILINE)


class Spent(NamedTuple):
    """What a command has taken, with its children.

    cpu_s, wall_s: time, s.
    peak_mb: most memory that one of its processes held, MB.
    """

    cpu_s: float
    wall_s: float
    peak_mb: float


def spent(command: Sequence[str], *, sets: Mapping[str, str] | None = None) -> Spent:
    """Run a command to its end.

    Args:
        command: program and arguments.
        sets: changes of the environment.

    Raises:
        HilError: its exit status is not 0; the message has the last line that it said.
    """
    peaks, ended = [0], threading.Event()
    with tempfile.TemporaryFile() as said:
        begun = time.perf_counter()
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=said, env={**os.environ, **(sets or {})})
        watch = threading.Thread(target=_watch, args=(process.pid, peaks, ended))
        watch.start()
        try:
            _, status, usage = os.wait4(process.pid, 0)
        except BaseException:
            process.kill()
            process.wait()
            raise
        finally:
            wall_s = time.perf_counter() - begun
            ended.set()
            watch.join()
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            said.seek(0)
            last = (said.read().decode(errors="replace").strip().splitlines() or ["it said nothing"])[-1]
            raise HilError(f"{' '.join(command[2:])}: exit status {process.returncode}: {last}")
    return Spent(usage.ru_utime + usage.ru_stime, wall_s, peaks[0] * 1024 / 1e6)


def _watch(pid: int, peaks: list[int], ended: threading.Event) -> None:
    """Look how much a process and its children hold (kB): `ru_maxrss` would tell of this process, where it was forked, too."""
    while not ended.wait(_LOOK_S):
        for each in (pid, *_children(pid)):
            with suppress(OSError):
                peaks[0] = max([peaks[0], *map(int, _PEAK.findall(Path(f"/proc/{each}/status").read_text()))])


def _children(pid: int) -> list[int]:
    found = []
    with suppress(OSError):
        for task in Path(f"/proc/{pid}/task").iterdir():
            for child in map(int, (task / "children").read_text().split()):
                found += [child, *_children(child)]
    return found
