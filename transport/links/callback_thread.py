"""Threads that do not belong to Python, and call it: what one of them costs with every call, and how to pay it once.

A thread that was not started by Python gets a thread state when it calls, and loses it when the call returns. The memory of the
state's stack is mapped and unmapped each time: four page faults, and a word to every CPU that runs this process. Under a
hypervisor that is most of what a callback costs.
"""

from __future__ import annotations

import ctypes
from threading import get_ident


class CallbackThreads:
    """Keeps the thread state of every thread that calls, from its first call on, as long as the process lives.

    Reference: Python/C API, "Non-Python created threads", ``PyGILState_Ensure``: calls nest, and only the outermost release
    takes the state away. One that is never released keeps it, as every thread of Python's own has one.
    """

    __slots__ = ("_known",)

    def __init__(self) -> None:
        self._known: set[int] = set()

    def keep(self) -> None:
        """Keep the calling thread's state; called inside of a callback, first thing."""
        ident = get_ident()
        if ident not in self._known:
            self._known.add(ident)  # one for each thread of the library, of which there are few
            ctypes.pythonapi.PyGILState_Ensure()
