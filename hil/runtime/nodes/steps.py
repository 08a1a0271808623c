"""Work that is done in small steps, one in each slot: all of it at once would make a slot of a session in real time late."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from typing import TypeVar

Result = TypeVar("Result")


class Steps:
    """What is left to do of a piece of work."""

    def __init__(self) -> None:
        self._work: Iterator[None] | None = None

    def begin(self, work: Iterator[None]) -> None:
        """Finish what is left, and take the first step of another piece of work."""
        self.finish()
        self._work = work
        self.go_on()

    def go_on(self) -> None:
        """Take a step, if there is one."""
        if self._work is not None and next(self._work, True):  # a step returns None
            self._work = None

    def finish(self) -> None:
        """Take all steps that are left."""
        while self._work is not None:
            self.go_on()


def at_once(work: Generator[None, None, Result]) -> Result:
    """Take all steps of a piece of work, and return what it returns."""
    while True:
        try:
            next(work)
        except StopIteration as end:
            result: Result = end.value
            return result
