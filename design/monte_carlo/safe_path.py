"""Python processes that import nothing from the folder they are started in."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

_SAFE = "PYTHONSAFEPATH"


@contextmanager
def safe_path() -> Iterator[None]:
    """Start workers without the working folder on their path, where a ``pickle.py`` would stand before the standard library's.

    Workers and resource trackers of joblib, multiprocessing and dask start as ``python -m`` or ``python -c``, which put it
    there. A worker is then given the path of this process, so that what is found here is found there.
    """
    before = os.environ.get(_SAFE)
    os.environ[_SAFE] = "1"
    try:
        yield
    finally:
        if before is None:
            os.environ.pop(_SAFE, None)
        else:
            os.environ[_SAFE] = before
