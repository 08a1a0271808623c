"""Benchmarks: always two things measured in one run, always with their ratio; none decides a test.

Links and buses are measured between two processes: one answers, one drives and is commanded.
"""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from typing import IO, Final

GRACE_S: Final = 0.4


class Pair:
    """An answering process and a driving one that is given the number of round trips."""

    def __init__(self, echo: Sequence[str], drive: Sequence[str]) -> None:
        self._children: list[subprocess.Popen[str]] = []
        try:
            for command in (echo, drive):
                child = subprocess.Popen(
                    command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
                )
                self._children.append(child)
                line = self._pipe(child.stdout).readline().strip()
                if line != "ready":
                    raise OSError(line or "the process ended")
        except BaseException:
            self.close()
            raise

    @staticmethod
    def _pipe(stream: IO[str] | None) -> IO[str]:
        assert stream is not None
        return stream

    def ask(self, line: str) -> list[int]:
        """Return the numbers with which the driving process answers a line."""
        driver = self._children[1]
        stream = self._pipe(driver.stdin)
        stream.write(f"{line}\n")
        stream.flush()
        words = self._pipe(driver.stdout).readline().split()
        if not words:
            raise OSError("the driving process ended")
        return [int(word) for word in words]

    def drive(self, number: int) -> list[int]:
        """Make round trips; return ns for each, -1 where none came back."""
        trips = self.ask(f"{number}")
        if len(trips) != number:
            raise OSError("the driving process ended")
        return trips

    def close(self) -> None:
        """End both processes."""
        for child in self._children:
            child.terminate()
        for child in self._children:
            try:
                child.communicate(timeout=GRACE_S)  # they tidy up their links
            except subprocess.TimeoutExpired:
                child.kill()
                child.communicate()


def open_pair(stack: ExitStack, make: Callable[[], Pair]) -> Pair | str:
    """Return the pair, or why there is none."""
    try:
        pair = make()
    except (OSError, subprocess.CalledProcessError) as error:
        return str(error)
    stack.callback(pair.close)
    return pair
