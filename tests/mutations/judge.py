"""Whether tests see a fault: those that reach its block, nearest first, until one fails or their time is spent."""

from __future__ import annotations

import ast
import contextlib
import os
import re
import resource
import signal
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from types import TracebackType

from tests.changed import chosen_for
from tests.mutations.copies import environment
from tests.mutations.faults import ROOT
from tests.mutations.probe import LIMIT, NAMES, ORDER, rank
from tests.mutations.random_faults import Place
from tests.mutations.reach import Reach
from tests.mutations.warm import Warm

BUDGET_S = 30.0
"""Of the tests of one fault, by the time that they took without it."""
WALL_S = 600.0
"""For all tests of a fault, however busy the machine is: what waits for ever ends here."""
LIMITS = {resource.RLIMIT_CPU: 60, resource.RLIMIT_DATA: 6 << 30}
"""In s and bytes: what one process of faulty code may take: a loop that has no end any more is killed, and so is its fault."""
NEAREST, NEAREST_FILES = 16, 3
"""Tests that are asked first, for themselves: most faults are seen by one of them, and few files are imported for it."""


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


def own_tests(place: Place, root: Path = ROOT) -> list[str]:
    """Return the test files of a fault where no map says what reaches it: those of its file, room and package, nearest first.

    Nearest are those named after the file, then those that hold its names; behind them those named after what imports it.
    """
    path, names = Path(place.file), names_of(place, root)
    module = ".".join(path.with_suffix("").parts)
    said = re.compile(rf"^\s*(from {re.escape(module)} |import {re.escape(module)}\b)", re.M)
    users = {f"test_{file.stem}.py" for file in (root / path.parts[0]).rglob("*.py") if said.search(file.read_text())}
    chosen = [root / each for each in chosen_for([place.file], root)]
    files = [file for each in chosen for file in (sorted(each.rglob("test_*.py")) if each.is_dir() else [each])]
    files += sorted((root / "tests" / path.parts[0]).glob("test_*.py"))  # of what the whole package does
    files += sorted(file for file in (root / "tests").rglob("test_*.py") if file.name in users)

    def near(file: Path) -> tuple[bool, int, bool]:
        return file.name != f"test_{path.stem}.py" and file != root / path, rank(file.read_text(), names), file.name not in users

    return [file.relative_to(root).as_posix() for file in sorted(dict.fromkeys(files), key=near)]


def names_of(place: Place, root: Path = ROOT) -> str:
    """Return the names by which a test may call a fault's code, nearest first: its function, what holds that, its module's."""
    inner = [name for name in place.block.partition("#")[0].split(".") if not name.startswith("__")]
    tree = ast.parse((root / place.file).read_text())
    others = [each.name for each in tree.body if isinstance(each, ast.FunctionDef | ast.ClassDef)]
    return "\n".join(" ".join(line) for line in (inner[-1:], inner[:-1], [Path(place.file).stem, *others]) if line)


class Judge:
    """Runs tests over a copy of the checkout, sound or with one fault in it; a context that ends its processes.

    Args:
        folder: the copy.
        doubtful: tests that may fail because the machine is busy.
    """

    def __init__(self, folder: Path, doubtful: Collection[str] = ()) -> None:
        self._folder = folder
        self._doubtful = doubtful
        self._faults = 0
        self._warm = Warm(folder, environment(folder))

    def __enter__(self) -> Judge:
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None) -> None:
        self._warm.close()

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
        names = names_of(place, self._folder)
        while tests:
            with self._with(place):
                near = NEAREST if "::" in tests[0] else NEAREST_FILES
                failed = self._failing(tests[:near], names) or self._failing(tests[near:], names)
            if failed not in self._doubtful or self._failing([failed], names) is None:
                return failed
            tests = tests[tests.index(failed) + 1 :]  # it fails without the fault too
        return None

    def _failing(self, tests: Sequence[str], names: str) -> str | None:
        """Return the first of the tests that fails, or how pytest ended where none could."""
        files = [file for file in dict.fromkeys(test.partition("::")[0] for test in tests) if (self._folder / file).exists()]
        if not files:  # they have moved since they were measured
            return None
        env, choose = {LIMIT: str(BUDGET_S), NAMES: names}, ["-m", "not realtime"]
        if any("::" in test for test in tests):
            order = self._folder.parent / "order"
            order.write_text("\n".join(tests))
            env, choose, files = {ORDER: str(order)}, [], sorted(files)
        words = ["-x", *choose, "-p", "tests.mutations.probe", "-p", "no:cacheprovider", "--tb=no", "-rfE", *files]
        self._warm.start(words, env, LIMITS)
        try:
            ended = self._warm.end(WALL_S)
        finally:
            self._end_all()
        if ended is None:
            self._warm.end()  # it is killed now
            return "no end in time"
        status, out = ended
        if status in (0, 5):  # 5: the tests are gone since they were measured
            return None
        said = [line.split(" - ")[0].split(" ", 1)[1] for line in out.splitlines() if line.startswith(("FAILED ", "ERROR "))]
        return said[0].strip() if said else f"pytest ends with {status}"

    def _end_all(self) -> None:
        """Kill the run and what its tests started and left behind, which has the copy in its environment."""
        mark = f"PYTHONPATH={self._folder}".encode()
        for proc in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError):
                if int(proc.name) != self._warm.pid and mark in (proc / "environ").read_bytes():
                    os.kill(int(proc.name), signal.SIGKILL)
