"""What is set for a whole process: one thread of linear algebra, and signals that wait.

Of matrices as small as ours, threads of linear algebra only wait for each other, and with one of them sums have one order.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar
from functools import lru_cache
from typing import Any, Final

_BEGAN_WITH_ONE: Final = ContextVar("every BLAS of this process began with one thread", default=False)


def begin_with_one_thread() -> None:
    """Note that every BLAS begins with one thread: before one is loaded, where the environment asks for it.

    To look for libraries and ask each takes 3 % of a short run, and this nothing. In another thread they are asked.
    """
    asked = {value for name, value in os.environ.items() if name.endswith("_NUM_THREADS")}
    _BEGAN_WITH_ONE.set("numpy" not in sys.modules and "OPENBLAS_NUM_THREADS" in os.environ and asked == {"1"})


def one_blas_thread() -> AbstractContextManager[Any]:
    """Give every BLAS of this process one thread, inside a ``with``.

    Which libraries are loaded is looked up when modules were imported since: that takes a millisecond, a small certificate less.

    >>> from threadpoolctl import threadpool_info
    >>> with one_blas_thread():
    ...     {each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"} <= {1}
    True
    """
    if _BEGAN_WITH_ONE.get():
        return nullcontext()
    limited: AbstractContextManager[Any] = _libraries(len(sys.modules)).limit(limits=1, user_api="blas")
    return limited


@lru_cache(maxsize=1)
def _libraries(_modules: int) -> Any:
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


_ENDING: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
"""Signals that ask a process to end; `hil.errors`, which imports no package of ours, has them too."""


@contextmanager
def signals_later() -> Iterator[None]:
    """Let no such signal come before the end of the block: what is made in it has its name by then, and can be taken away.

    The handlers wait, as a mask would hold for one thread only, and the libraries of linear algebra have threads of their own.
    """
    came: list[int] = []
    theirs = {number: handler for number in _ENDING if callable(handler := signal.getsignal(number))}
    for number in theirs:
        signal.signal(number, lambda number, _frame: came.append(number))
    try:
        yield
    finally:
        for number, handler in theirs.items():
            signal.signal(number, handler)
        if came:
            signal.raise_signal(came[0])
