"""A virtual slot of two versions of this program: the least CPU time of many short turns, each version in a process of its own.

What else a machine does only adds to the time of a turn, so the least of many is steady where their median is not.
"""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from typing import Final

from hil.errors import HilError
from hil.runtime.real.child import PYTHON

WRITERS: Final = ("ours", "none")
"""With its log, and without."""

_TURNS: Final = """
import gc, sys, tempfile
from functools import partial
from pathlib import Path
from {module} import _cpu, _virtual, compose, load_experiment
slots = {slots}
loop = compose(load_experiment("dc-motor-hinf", [f"duration={{slots * 0.05!r}}"]), certify=False)
with tempfile.TemporaryDirectory(prefix="hilrig-bench-") as folder:
    for line in sys.stdin:
        writer = line.strip()
        gc.collect()
        print(_cpu(partial(_virtual, loop, writer, Path(folder) / writer)) / slots * 1e6, flush=True)
"""


class _Version:
    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        self._process = process

    def turn_us(self, writer: str) -> float:
        """Run one turn; return CPU time of a slot, us."""
        asked, answered = self._process.stdin, self._process.stdout
        assert asked is not None and answered is not None
        with suppress(BrokenPipeError):  # of one that has ended nothing is read
            asked.write(f"{writer}\n".encode())
        line = answered.readline()
        if not line:
            raise HilError(f"{self._process.args[-1]!r}: it ended before it had measured a turn")  # type: ignore[index]
        return float(line)


@contextmanager
def _started(module: str, slots: int, sets: Mapping[str, str]) -> Iterator[_Version]:
    command = [*PYTHON, "-c", _TURNS.format(module=module, slots=slots)]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0, env=os.environ | sets
    ) as process:  # ends where no turn is asked of it any more
        try:
            yield _Version(process)
        except BaseException:
            process.kill()
            raise


def least_us(versions: Mapping[str, tuple[str, Mapping[str, str]]], *, slots: int, turns: int) -> dict[str, list[float]]:
    """Return for each version the least CPU time of a slot, us: with its log, and without.

    Args:
        versions: name to the module that has its bench of a slot, and the changes of the environment in which that is found.
        slots: of a turn.
        turns: of each version, one after the other; one more before them is not counted.
    """
    least = {name: [float("inf")] * len(WRITERS) for name in versions}
    with ExitStack() as stack:
        started = {name: stack.enter_context(_started(module, slots, sets)) for name, (module, sets) in versions.items()}
        for turn in range(turns + 1):
            for i, writer in enumerate(WRITERS):
                for name, version in started.items():
                    taken = version.turn_us(writer)
                    if turn:
                        least[name][i] = min(least[name][i], taken)
    return least
