"""Who watches this process while users' modules run in it; see `hil.cli.guard`. A library and a notebook have none."""

from __future__ import annotations

from contextvars import ContextVar
from typing import Final, Protocol


class Watch(Protocol):
    """Receives what it cannot see from outside."""

    def begin(self, module: str) -> None:
        """Watch from here: the first line of a module, named by its file, is next."""
        ...

    def stopping(self) -> None:
        """A signal was heeded: what ends now ends in order, and closes its log."""
        ...


class _Unwatched:
    def begin(self, module: str) -> None:
        pass

    def stopping(self) -> None:
        pass


WATCH: Final[ContextVar[Watch]] = ContextVar("who watches this process", default=_Unwatched())  # noqa: B039 (it has no state)
