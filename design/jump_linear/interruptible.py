"""Long computations in C that Ctrl-C ends at once: Python looks at signals between its own instructions alone."""

from __future__ import annotations

import threading
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def interruptible(compute: Callable[[], Array]) -> Array:
    """Return what a function returns, computed beside the main thread, which waits and takes signals meanwhile.

    Args:
        compute: long in C, without a call of Python's: after Ctrl-C its thread ends with the call, or with the process, and
            SuperLU, which allocates by Python, breaks Python's end there.

    Raises:
        Exception: what the function raised.
    """
    if threading.current_thread() is not threading.main_thread():
        return compute()
    found: list[Array] = []
    failed: list[BaseException] = []

    def run() -> None:
        try:
            found.append(compute())
        except BaseException as error:  # raised again where it was asked for
            failed.append(error)

    beside = threading.Thread(target=run, daemon=True)
    beside.start()
    beside.join()
    if failed:
        raise failed[0]
    return found[0]


def spectral_radius(matrix: Array) -> float:
    """Return the largest absolute eigenvalue of a matrix of any size (n, n), by all of them."""
    return float(np.abs(interruptible(lambda: np.asarray(np.linalg.eigvals(matrix)))).max())
