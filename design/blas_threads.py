"""One thread of linear algebra: of matrices as small as ours, threads only wait for each other, and sums have one order."""

from __future__ import annotations

import sys
from contextlib import AbstractContextManager
from functools import lru_cache
from typing import Any

from threadpoolctl import ThreadpoolController


def one_blas_thread() -> AbstractContextManager[Any]:
    """Give every BLAS of this process one thread, inside a ``with``.

    Which libraries are loaded is looked up when modules were imported since: that takes a millisecond, a small certificate less.

    >>> from threadpoolctl import threadpool_info
    >>> with one_blas_thread():
    ...     {each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"} <= {1}
    True
    """
    limited: AbstractContextManager[Any] = _libraries(len(sys.modules)).limit(limits=1, user_api="blas")
    return limited


@lru_cache(maxsize=1)
def _libraries(_modules: int) -> Any:
    return ThreadpoolController()
