"""Whether tests see a fault: those that reach its block, nearest first, until one fails or their time is spent."""

from __future__ import annotations

import contextlib
import os
import resource
import signal
import subprocess
import sys
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path

from tests.changed import chosen_for
from tests.mutations.copies import environment
from tests.mutations.faults import ROOT
from tests.mutations.probe import ORDER
from tests.mutations.random_faults import Place
from tests.mutations.reach import Reach

BUDGET_S = 30.0
"""Of the tests of one fault, by the time that they took without it."""
WALL_S = 600.0
"""For all tests of a fault, however busy the machine is: what waits for ever ends here."""
LIMITS = {resource.RLIMIT_CPU: 120, resource.RLIMIT_DATA: 6 << 30}
"""In s and bytes: what one process of faulty code may take: a loop that has no end any more is killed, and so is its fault."""


def asked_for(place: Place, reach: Reach, root: Path = ROOT) -> list[str]:
    """Return the tests of a fault in the order in which they are asked.

    Those of the file's own tests come first, then those of its room, then others; cheap ones first, real time last. Behind those
    that reach the block come the others of their files, which may share what the first one made. A block that no test reaches
    has none; outside of functions the tests are those that reach a function of the file, then those that import it.
    """
    mirror, own = f"tests/{Path(place.file).parent.as_posix()}/", f"test_{Path(place.file).stem}.py"
    near = chosen_for([place.file], root)
    if place.block:
        reaching = {*reach.by_block.get(f"{place.file}::{place.block}", ())}
        files = {reach.tests[n].partition("::")[0] for n in reaching}
    else:
        reaching = {n for block, tests in reach.by_block.items() if block.startswith(f"{place.file}::") for n in tests}
        files = {test.partition("::")[0] for test in reach.tests}
        files = {file for file in files if any(file == each or file.startswith(f"{each}/") for each in near)}

    def rank(n: int) -> tuple[bool, bool, bool, bool, float]:
        file = Path(reach.tests[n].partition("::")[0])
        named = file.name == own
        return n not in reaching, reach.realtime[n], not named, not file.as_posix().startswith(mirror), reach.seconds[n]

    chosen, spent = [], 0.0
    for n in sorted((n for n, test in enumerate(reach.tests) if n in reaching or test.partition("::")[0] in files), key=rank):
        spent += reach.seconds[n]
        if chosen and spent > BUDGET_S:
            break
        chosen.append(reach.tests[n])
    return chosen


class Judge:
    """Runs tests over a copy of the checkout, sound or with one fault in it.

    Args:
        folder: the copy.
        doubtful: tests that may fail because the machine is busy.
    """

    def __init__(self, folder: Path, doubtful: Collection[str] = ()) -> None:
        self._folder = folder
        self._doubtful = doubtful
        self._faults = 0

    @contextlib.contextmanager
    def _with(self, place: Place) -> Iterator[None]:
        file = self._folder / place.file
        sound, was = file.read_text(), file.stat().st_mtime_ns
        self._faults += 1
        try:
            file.write_text(place.put_into(sound))
            os.utime(file, ns=(was, was + self._faults * 10**9))  # bytecode is distinguished by whole seconds and size
            yield
        finally:
            file.write_text(sound)
            os.utime(file, ns=(was, was))

    def killer(self, place: Place, tests: Sequence[str]) -> str | None:
        """Return the first test that fails with the fault, and passes without it if it runs in real time; None if none does."""
        while tests:
            with self._with(place):
                failed = self._failing(tests)
            if failed not in self._doubtful or self._failing([failed]) is None:
                return failed
            tests = tests[tests.index(failed) + 1 :]  # it fails without the fault too
        return None

    def _failing(self, tests: Sequence[str]) -> str | None:
        """Return the first of the tests that fails, or how pytest ended where none could."""
        files = sorted(file for file in {test.partition("::")[0] for test in tests} if (self._folder / file).exists())
        if not files:  # they have moved since they were measured
            return None
        order = self._folder.parent / "order"
        order.write_text("\n".join(tests))
        words = ["-x", "-p", "tests.mutations.probe", "-p", "no:cacheprovider", "--tb=no", "-rfE", *files]
        child = subprocess.Popen(
            [sys.executable, "-m", "pytest", *words], cwd=self._folder, env=environment(self._folder) | {ORDER: str(order)},
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace",
            start_new_session=True,
        )  # fmt: skip
        try:
            for what, limit in LIMITS.items():
                resource.prlimit(child.pid, what, (limit, limit))
            out, _ = child.communicate(timeout=WALL_S)
        except subprocess.TimeoutExpired:
            return "no end in time"
        finally:
            self._end_all(child)
        if child.returncode in (0, 5):  # 5: the tests are gone since they were measured
            return None
        said = [line.split(" - ")[0].split(" ", 1)[1] for line in out.splitlines() if line.startswith(("FAILED ", "ERROR "))]
        return said[0].strip() if said else f"pytest ends with {child.returncode}"

    def _end_all(self, child: subprocess.Popen[str]) -> None:
        """Kill what the tests started and left behind, which has the copy in its environment."""
        mark = f"PYTHONPATH={self._folder}".encode()
        for proc in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError):
                if mark in (proc / "environ").read_bytes():
                    os.kill(int(proc.name), signal.SIGKILL)
        child.communicate()
