"""What a test reaches, written while it runs: in instrumented code each block calls `note` when it is first reached in a test.

A process of its own that a test starts writes too: pytest says in the environment which test runs. As a plug-in of pytest
(``-p tests.mutations.probe``) it also notes how long each test takes, and orders the tests as a list says.
"""

from __future__ import annotations

import inspect
import os
import re
from pathlib import Path
from typing import Any

FOLDER, ORDER, LIMIT, NAMES = "HILRIG_REACHED", "HILRIG_ORDER", "HILRIG_LIMIT", "HILRIG_NAMES"
"""Environment: the folder where each process writes a file of its own; the list of tests in order; their CPU time in s; lines of
words: tests that hold one of an earlier line come first."""
SPENT = 10
"""Exit status of a run whose time is spent before its tests are."""
seen: set[int] = set()
_cpu = [0.0]
_out: dict[int, tuple[int, os.stat_result]] = {}  # of this process: one open file, and which it is


def note(block: int) -> None:
    """Write that a block was reached."""
    seen.add(block)
    if not _is_open():
        begin(os.environ.get("PYTEST_CURRENT_TEST", "").rpartition(" ")[0])
        seen.add(block)
    _write(f"{block}\n")


def begin(test: str) -> None:
    """Write that what follows belongs to a test, which has reached nothing yet."""
    seen.clear()
    _write(f"T{test}\n")


def _is_open() -> bool:
    """Whether the file of this process is open; a test may close it, and something else has its number then."""
    fd, file = _out.get(os.getpid(), (-1, None))
    try:
        return file is not None and os.path.samestat(os.fstat(fd), file)
    except OSError:
        return False


def _write(line: str) -> None:
    try:
        if not _is_open():
            _out.clear()
            fd = os.open(f"{os.environ[FOLDER]}/{os.getpid()}", os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o600)
            _out[os.getpid()] = fd, os.fstat(fd)
        os.write(_out[os.getpid()][0], line.encode())
    except (OSError, KeyError):  # a test may take descriptors, environment and rights away
        return


os.register_at_fork(after_in_child=seen.clear)


def pytest_runtest_logstart(nodeid: str) -> None:
    """Begin a test."""
    if FOLDER in os.environ:
        begin(nodeid)
        _cpu_s()


def pytest_runtest_makereport(item: Any, call: Any) -> None:
    """Write how long a part of a test took, in s of CPU time, in real time of the clock, and whether it ended well."""
    if FOLDER in os.environ:
        realtime, ended, cpu_s = item.get_closest_marker("realtime") is not None, call.excinfo is None, _cpu_s()
        _write(f"D{call.duration if realtime else cpu_s:.4f} {realtime:d} {ended:d} {item.nodeid}\n")


def _cpu_s() -> float:
    """CPU time since the last call, of this process and those that it waited for: a busy machine makes no test longer."""
    last, _cpu[0] = _cpu[0], sum(os.times()[:4])
    return _cpu[0] - last


def pytest_runtest_logfinish() -> None:
    """End the run where its time is spent."""
    if LIMIT in os.environ and sum(os.times()[:4]) > float(os.environ[LIMIT]):
        import pytest

        pytest.exit("no time is left", returncode=SPENT)


def pytest_collection_modifyitems(items: list[Any]) -> None:
    """Keep the tests of the list, in its order; or bring those to the front that hold the words."""
    if ORDER in os.environ:
        place = {name: n for n, name in enumerate(Path(os.environ[ORDER]).read_text().splitlines())}
        items[:] = sorted((item for item in items if item.nodeid in place), key=lambda item: place[item.nodeid])
    elif NAMES in os.environ:
        items.sort(key=lambda item: rank(_source(item), os.environ[NAMES]))


def rank(text: str, names: str) -> int:
    """Return the first line of which a text holds a word; their number if none.

    >>> [rank(text, "inner\\nouter Class") for text in ("inner()", "a Class", "the_inner")]
    [0, 1, 2]
    """
    lines = [line.split() for line in names.splitlines()]
    held = {*re.findall(r"\w+", text)}
    return next((n for n, words in enumerate(lines) if not held.isdisjoint(words)), len(lines))


def _source(item: Any) -> str:
    try:
        return inspect.getsource(item.obj)
    except (AttributeError, OSError, TypeError):  # a doctest
        return os.environ[NAMES]
