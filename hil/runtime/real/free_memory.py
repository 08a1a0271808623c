"""Memory that is free, given back to the system: a process that runs for days holds what it uses, and not what it once used."""

from __future__ import annotations

import ctypes
from typing import Final

EVERY_NS: Final = 1_000_000_000


class FreeMemory:
    """Gives back what the C library keeps of freed memory, once a second; without glibc it does nothing.

    Args:
        now_ns: monotonic time, ns.
    """

    def __init__(self, now_ns: int) -> None:
        self._trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        self._due_ns = now_ns + EVERY_NS

    def look(self, now_ns: int) -> None:
        """Give it back if it is time; takes less than a millisecond."""
        if self._trim is not None and now_ns >= self._due_ns:
            self._due_ns = now_ns + EVERY_NS
            self._trim(0)
