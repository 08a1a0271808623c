"""Long computations in C that Ctrl-C ends at once: Python looks at signals between its own instructions alone."""

from __future__ import annotations

import io
import os
import signal
import threading
import warnings
from collections.abc import Callable
from contextlib import suppress
from select import select
from typing import NoReturn

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

LOOK_S = 0.1
"""How often a wait looks at signals: one that comes just before the wait begins does not end it."""


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
    while beside.is_alive():
        beside.join(LOOK_S)
    if failed:
        raise failed[0]
    return found[0]


def apart(compute: Callable[[], Array]) -> Array:
    """Return what a function returns, computed in a copy of this process, which Ctrl-C ends with the wait for it.

    For what may not be left behind in a thread, as SuperLU. Outside the main thread, which alone takes signals, it is computed
    where it is asked for.

    Args:
        compute: returns numbers, and touches nothing else.

    Raises:
        numpy.linalg.LinAlgError: the copy came to no end, for lack of memory for instance; or what it computed has none.
    """
    if threading.current_thread() is not threading.main_thread():
        return compute()
    reads, writes = os.pipe()
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})  # until there is who ends the copy
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # the copy computes, and meets no lock of another thread
        child = os.fork()
    if not child:
        _answer(compute, writes)
    try:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        os.close(writes)
        while not select([reads], [], [], LOOK_S)[0]:
            pass
        with open(reads, "rb", closefd=False) as file:
            said = file.read()
    finally:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        os.close(reads)
    if not said:
        raise np.linalg.LinAlgError("its factorisation came to no end, or has none")
    found: Array = np.load(io.BytesIO(said), allow_pickle=False)
    return found


def _answer(compute: Callable[[], Array], writes: int) -> NoReturn:
    """Write what a function returns, and end this copy of the process without its end."""
    with suppress(BaseException):
        text = io.BytesIO()
        np.save(text, compute())
        with open(writes, "wb") as file:
            file.write(text.getvalue())
    os._exit(0)


def spectral_radius(matrix: Array) -> float:
    """Return the largest absolute eigenvalue of a matrix of any size (n, n), by all of them."""
    return float(np.abs(interruptible(lambda: np.asarray(np.linalg.eigvals(matrix)))).max())
