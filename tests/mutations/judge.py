"""Whether tests see a fault: those that reach its block, nearest first, until one fails or their time is spent."""

from __future__ import annotations

import ast
import contextlib
import math
import os
import re
import resource
import signal
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import ExitStack
from pathlib import Path
from queue import SimpleQueue
from tempfile import TemporaryDirectory
from types import TracebackType
from typing import TypeVar

from tests.changed import chosen_for
from tests.mutations.copies import copy_of_the_checkout, environment
from tests.mutations.faults import ROOT, Fault
from tests.mutations.probe import LIMIT, NAMES, ORDER, SPENT, rank
from tests.mutations.random_faults import Place
from tests.mutations.reach import Reach
from tests.mutations.warm import Warm

Item, Answer = TypeVar("Item"), TypeVar("Answer")

BUDGET_S = 30.0
"""Of the tests of one fault, by the time that they took without it."""
WALL_S, TEST_S = 600.0, 60.0
"""For all tests of a fault and for one of them, however busy the machine is: what waits for ever ends here."""
LIMITS = {resource.RLIMIT_CPU: 60, resource.RLIMIT_DATA: 6 << 30}
"""In s and bytes: what one process of faulty code may take: a loop that has no end any more is killed, and so is its fault."""
NEAREST, NEAREST_FILES = 16, 3
"""Tests that are asked first, for themselves: most faults are seen by one of them, and few files are imported for it."""

EVERY_MODULE = "tests/contract/test_data.py"
"""Looks at what classes say of themselves."""


def asked_for(place: Place, reach: Reach, root: Path = ROOT) -> list[str]:
    """Return the tests of a fault in the order in which they are asked.

    Those of the file's own tests come first, then those of its room, then others; cheap ones first, real time last. Behind those
    that reach the block come the others of their files, which may share what the first one made. A block that no test reaches
    has none; outside of functions the tests are those that reach a function of the file or import it, and one of all modules.
    """
    mirror, own = f"tests/{Path(place.file).parent.as_posix()}/", f"test_{module_of(place.file)[-1]}.py"
    near = chosen_for([place.file], root)
    if place.block:
        reaching = {*reach.by_block.get(f"{place.file}::{place.block}", ())}
        files = {reach.tests[n].partition("::")[0] for n in reaching}
    else:
        reaching = {n for block, tests in reach.by_block.items() if block.startswith(f"{place.file}::") for n in tests}
        files = {test.partition("::")[0] for test in reach.tests}
        files = {file for file in files if any(file == each or file.startswith(f"{each}/") for each in near)}

    def rank(n: int) -> tuple[bool, bool, bool, bool, bool, float]:
        file, far = Path(reach.tests[n].partition("::")[0]), n not in reaching
        foreign = not file.as_posix().startswith(mirror)
        return far and place.block != "", reach.realtime[n], file.name != own, foreign, far, reach.seconds[n]

    chosen, spent = [], 0.0
    for n in sorted((n for n, test in enumerate(reach.tests) if n in reaching or test.partition("::")[0] in files), key=rank):
        spent += reach.seconds[n]
        if chosen and spent > BUDGET_S:
            break
        chosen.append(reach.tests[n])
    return chosen if place.block else [*chosen, EVERY_MODULE]


def own_tests(place: Place, root: Path = ROOT) -> list[str]:
    """Return the test files of a fault where no map says what reaches it: those of its file, room and package, nearest first.

    Nearest are those named after the file, then those that hold its names; behind them those named after what imports it.
    """
    path, names = Path(place.file), names_of(place, root)
    module, own = ".".join(module_of(place.file)), f"test_{module_of(place.file)[-1]}.py"
    said = re.compile(rf"^\s*(from {re.escape(module)} |import {re.escape(module)}\b)", re.M)
    users = {f"test_{file.stem}.py" for file in (root / path.parts[0]).rglob("*.py") if said.search(file.read_text())}
    chosen = [root / each for each in chosen_for([place.file], root)]
    files = [file for each in chosen for file in (sorted(each.rglob("test_*.py")) if each.is_dir() else [each])]
    files += sorted((root / "tests" / path.parts[0]).glob("test_*.py"))  # of what the whole package does
    files += sorted(file for file in (root / "tests").rglob("test_*.py") if file.name in users)

    def near(file: Path) -> tuple[bool, int, bool]:
        return file.name != own and file != root / path, rank(file.read_text(), names), file.name not in users

    return [file.relative_to(root).as_posix() for file in sorted(dict.fromkeys(files), key=near)]


def module_of(file: str) -> tuple[str, ...]:
    """Return the parts of a module's name; those of its folder for an ``__init__.py``."""
    *folder, stem = Path(file).with_suffix("").parts
    return (*folder,) if stem == "__init__" else (*folder, stem)


def names_of(place: Place, root: Path = ROOT) -> str:
    """Return the names by which a test may call a fault's code, nearest first: its function, what holds that, its module's."""
    inner = [name for name in place.block.partition("#")[0].split(".") if not name.startswith("__")]
    tree = ast.parse((root / place.file).read_text())
    others = [each.name for each in tree.body if isinstance(each, ast.FunctionDef | ast.ClassDef)]
    return "\n".join(" ".join(line) for line in (inner[-1:], inner[:-1], [module_of(place.file)[-1], *others]) if line)


class UndecidedError(Exception):
    """Time was spent before a test failed and before all had passed."""


class Judge:
    """Runs tests over a copy of the checkout, sound or with one fault in it; a context that ends its processes.

    Args:
        folder: the copy.
        doubtful: tests that may fail because the machine is busy.
    """

    def __init__(self, folder: Path, doubtful: Collection[str] = ()) -> None:
        self._folder = folder
        self._doubtful = doubtful
        self._faults, self._end, self._spent, self._timed_out = 0, math.inf, False, False
        self._warm = Warm(folder, environment(folder))

    def __enter__(self) -> Judge:
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None) -> None:
        self._warm.close()

    @contextlib.contextmanager
    def _with(self, fault: Place | Fault) -> Iterator[None]:
        file = self._folder / fault.file
        sound, was = file.read_text(), file.stat().st_mtime_ns
        self._faults += 1
        try:
            file.write_text(fault.put_into(sound))
            os.utime(file, ns=(was, was + self._faults * 10**9))  # bytecode is distinguished by whole seconds and size
            yield
        finally:
            file.write_text(sound)
            os.utime(file, ns=(was, was))

    def sees(self, fault: Fault) -> bool:
        """Return whether a known fault's tests fail with it."""
        with self._with(fault):
            ended = self._run(fault.tests, {}, {}, WALL_S)
        if ended is not None and ended[0] not in (0, 1):
            raise SystemExit(f"{fault.name}: pytest ends with {ended[0]}:\n{ended[1]}")
        return ended is None or ended[0] == 1

    def killer(self, place: Place, tests: Sequence[str], end: float = math.inf) -> str | None:
        """Return the first test that fails with the fault, and passes without it if time may have failed it; None if none.

        Args:
            place: the fault.
            tests: names of tests, or of test files, whose tests in real time are left out.
            end: monotonic time until which they may run, s.

        Raises:
            UndecidedError: CPU time of tests of one fault, or all time, was spent before, or a test file fails without it too.
        """
        names, self._end, self._spent = names_of(place, self._folder), end, False
        while tests:
            with self._with(place):
                near = NEAREST if "::" in tests[0] else NEAREST_FILES
                failed = self._failing(tests[:near], names) or self._failing(tests[near:], names)
            if failed is None:
                break
            if not (failed in self._doubtful or self._timed_out) or self._failing([failed], names) is None:
                return failed
            if failed not in tests:
                raise UndecidedError(f"{failed} fails without the fault too")
            tests = tests[tests.index(failed) + 1 :]
        if self._spent:
            raise UndecidedError(f"{len(tests)} asked until time was spent")
        return None

    def _failing(self, tests: Sequence[str], names: str) -> str | None:
        """Return the first of the tests that fails, or how pytest ended where none could."""
        self._timed_out = False
        files = [file for file in dict.fromkeys(test.partition("::")[0] for test in tests) if (self._folder / file).exists()]
        if not files:  # they have moved since they were measured
            return None
        env, choose = {LIMIT: str(BUDGET_S), NAMES: names}, ["-m", "not realtime"]
        if any("::" in test for test in tests):
            order = self._folder.parent / "order"
            order.write_text("\n".join(tests))
            env, choose, files = {ORDER: str(order)}, [], sorted(files)
        words = [*choose, "-p", "tests.mutations.probe", "-o", f"timeout={TEST_S}", *files]
        left_s = self._end - time.monotonic()
        ended = self._run(words, env, LIMITS, min(WALL_S, left_s)) if left_s > 0.0 else None
        if ended is None:
            self._spent = True
            return None
        status, out = ended
        if status in (0, 5, SPENT):  # 5: the tests are gone since they were measured
            self._spent |= status == SPENT
            return None
        self._timed_out = "Failed: Timeout" in out
        said = [line.split(" - ")[0].split(" ", 1)[1] for line in out.splitlines() if line.startswith(("FAILED ", "ERROR "))]
        return said[0].strip() if said else f"pytest ends with {status}"

    def _run(
        self, words: Sequence[str], env: Mapping[str, str], limits: Mapping[int, int], wall_s: float
    ) -> tuple[int, str] | None:  # fmt: skip
        """Return status and output of pytest, None where it has not ended after so many s; nothing of it runs any more then."""
        self._warm.start(["-x", "-p", "no:cacheprovider", "--tb=no", "-rfE", *words], env, limits)
        try:
            ended = self._warm.end(wall_s)
        finally:
            self._end_all()
        if ended is None:
            self._warm.end()  # it is killed now
        return ended

    def _end_all(self) -> None:
        """Kill the run and what its tests started and left behind, which has the copy in its environment."""
        mark = f"PYTHONPATH={self._folder}\0".encode()
        for proc in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError):
                if int(proc.name) != self._warm.pid and mark in (proc / "environ").read_bytes():
                    os.kill(int(proc.name), signal.SIGKILL)


def at_once(
    items: Sequence[Item], ask: Callable[[Judge, Item], Answer], workers: int, doubtful: Collection[str] = ()
) -> Iterator[tuple[Item, Answer]]:  # fmt: skip
    """Yield each item with its answer as soon as it has one; several are asked at once, each in a copy of its own.

    Args:
        items: what is asked about, such as faults.
        ask: asks a judge that is free.
        workers: how many judges there are.
        doubtful: tests that may fail because the machine is busy.
    """
    free: SimpleQueue[Judge] = SimpleQueue()

    def answer(item: Item) -> Answer:
        judge = free.get()
        try:
            return ask(judge, item)
        finally:
            free.put(judge)

    with TemporaryDirectory() as name, ExitStack() as stack, ThreadPoolExecutor(workers) as pool:
        for n in range(workers):
            free.put(stack.enter_context(Judge(copy_of_the_checkout(Path(name, str(n), "checkout")), doubtful)))
        running = {pool.submit(answer, item): item for item in items}
        try:
            for future in as_completed(running):
                yield running[future], future.result()
        finally:
            pool.shutdown(cancel_futures=True)
