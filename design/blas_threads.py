"""One thread of linear algebra: of matrices as small as ours, threads only wait for each other, and sums have one order."""

from __future__ import annotations

import os
import sys
from contextlib import AbstractContextManager, nullcontext
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
