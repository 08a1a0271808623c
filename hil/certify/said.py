"""What a plant and a controller say of themselves, asked once: who judges and who tests leans on the same answer."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

T = TypeVar("T")


class Said:
    """Keeps the first answer to every question."""

    def __init__(self) -> None:
        self._known: dict[str, Any] = {}

    def once(self, name: str, ask: Callable[[], T]) -> T:
        """Return the answer to a question, asked at most once.

        Args:
            name: of the question.
            ask: asks it.
        """
        if name not in self._known:
            self._known[name] = ask()
        answer: T = self._known[name]
        return answer
