"""Benchmarks: always two things measured in one run, always with their ratio; none decides a test.

Links and buses are measured between two processes: one answers, one drives and is commanded.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from typing import IO, Any, Final

from hil.runtime.real import die_with_parent

GRACE_S: Final = 1.0

Commands = tuple[Sequence[str], Sequence[str]]
"""Of the process that answers, and of the one that drives."""

Ask = Callable[[str], list[int]]
"""Give the driving process a line; return the numbers with which it answers. `OSError`: it has ended."""


def _pipe(stream: IO[str] | None) -> IO[str]:
    assert stream is not None
    return stream


@contextmanager
def running(command: Sequence[str]) -> Iterator[subprocess.Popen[str]]:
    """Run a process, which says in its first line that it is ready; end it with the block.

    Raises:
        OSError: what it said instead.
    """
    child = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    try:
        line = _pipe(child.stdout).readline().strip()
        if line != "ready":
            raise OSError(line or "the process ended")
        yield child
    finally:
        child.terminate()
        try:
            child.communicate(timeout=GRACE_S)  # it tidies up its link
        except subprocess.TimeoutExpired:
            child.kill()
            child.communicate()


def _ask(driver: subprocess.Popen[str], line: str) -> list[int]:
    stream = _pipe(driver.stdin)
    stream.write(f"{line}\n")
    stream.flush()
    words = _pipe(driver.stdout).readline().split()
    if not words:
        raise OSError("the driving process ended")
    return [int(word) for word in words]


def open_pair(stack: ExitStack, commands: Callable[[], Commands]) -> Ask | str:
    """Return what asks the driving process of a pair that ends with a stack, or why there is none."""
    with ExitStack() as pair:
        try:
            _, driver = [pair.enter_context(running(command)) for command in commands()]
        except (OSError, subprocess.CalledProcessError) as error:
            return str(error)
        stack.enter_context(pair.pop_all())
    return partial(_ask, driver)


@contextmanager
def killed(*processes: subprocess.Popen[Any] | None) -> Iterator[None]:
    """Kill what still runs of some processes when the block is left."""
    try:
        yield
    finally:
        for process in filter(None, processes):
            if process.poll() is None:
                process.kill()
                process.wait()


@contextmanager
def part_of_pair(*failures: type[Exception]) -> Iterator[None]:
    """Be one of the processes of a pair: end with the other one, and say in the first line what kept it from being ready.

    Args:
        failures: that are said.
    """
    die_with_parent(os.getppid())
    signal.signal(signal.SIGTERM, lambda *_: sys.exit())
    try:
        yield
    except failures as error:
        print(error, flush=True)  # noqa: T201 (this is the process's interface)
        raise SystemExit(1) from error
