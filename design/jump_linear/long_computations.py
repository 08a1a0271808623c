"""Large linear algebra that always ends: GMRES with a limit, and computations in C that Ctrl-C ends at once.

Python looks at signals between its own instructions alone, so that what is long in C runs beside the main thread.
"""

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

from design.whole_process import signals_later

Array = npt.NDArray[np.float64]

BASIS, PRODUCTS = 120, 240
"""Vectors kept before a restart, and most products of one solve. Loops of radius 0.99 with 12,000 unknowns take about 100."""

ACCEPTABLE = 1e-9
"""Residual that will do where rounding lets it fall no further."""


def gmres(
    apply: Callable[[Array], Array],
    right: Array,
    *,
    tolerance: float = 1e-13,
    start: Array | None = None,
    products: int = PRODUCTS,
) -> Array | None:
    """Return x with apply(x) = right, or None if it was not found within so many products.

    scipy's GMRES spends two thirds of its time in Python around products of 20 to 50 us, and on the edge of stability it runs for
    thousands of products and then returns a vector that misses its tolerance. This one keeps its basis in one array and says
    when it has not converged: then the operator has an eigenvalue so near 1 that the loop counts as not stable there.

    Args:
        apply: the matrix, (size,) -> (size,), such as I - L.
        right: (size,).
        tolerance: residual to reach, as a share of |right|.
        start: (size,) a guess of x; default zero.
        products: most of them.
    """
    scale = float(np.linalg.norm(right))
    if scale == 0.0:
        return np.zeros_like(right)
    x, residual, spent = np.zeros_like(right), right, 0
    if start is not None:
        x, residual, spent = start, right - apply(start), 1
        if float(np.linalg.norm(residual)) <= tolerance * scale:
            return x
    while True:
        step, used = _cycle(apply, residual, tolerance * scale, min(BASIS, products - spent))
        x, spent = x + step, spent + used + 1
        new = right - apply(x)
        size, before = float(np.linalg.norm(new)), float(np.linalg.norm(residual))
        residual = new
        if not np.isfinite(size):
            return None
        if size <= tolerance * scale:
            return x
        if spent >= products - 1 or size > 0.5 * before:  # rounding lets it fall no further, or it does not converge
            return x if size <= max(ACCEPTABLE, tolerance) * scale else None


def _cycle(apply: Callable[[Array], Array], residual: Array, goal: float, most: int) -> tuple[Array, int]:
    """One cycle from zero: the correction, and how many products it took."""
    beta = float(np.linalg.norm(residual))
    V = np.empty((most + 1, residual.size))
    H = np.zeros((most + 1, most))
    rotation: list[tuple[float, float]] = []
    rest = [beta]
    V[0] = residual / beta
    used = 0
    for k in range(most):
        w = apply(V[k])
        known = V[: k + 1]
        total = np.zeros(k + 1)
        for _ in range(2):  # Gram-Schmidt twice is orthogonal to rounding
            share = known @ w
            w -= share @ known
            total += share
        length = float(np.sqrt(w @ w))
        column: list[float] = total.tolist()
        for i, (c, s) in enumerate(rotation):
            upper, lower = column[i], column[i + 1]
            column[i], column[i + 1] = c * upper + s * lower, c * lower - s * upper
        radius = float(np.hypot(column[k], length))
        used = k + 1
        if not radius > 0.0:
            return np.full_like(residual, np.nan), used
        c, s = column[k] / radius, length / radius
        column[k] = radius
        rotation.append((c, s))
        H[: k + 1, k] = column
        rest[k:] = [c * rest[k], -s * rest[k]]
        if abs(rest[k + 1]) <= goal or length == 0.0:
            break
        V[k + 1] = w / length
    y = np.linalg.solve(H[:used, :used], np.array(rest[:used]))
    return y @ V[:used], used


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
    child = 0
    try:
        try:
            # What a handler raises while Python forks is printed and dropped: its locks are taken and given back there.
            with signals_later(), warnings.catch_warnings():
                warnings.simplefilter("ignore", DeprecationWarning)  # the copy computes, and meets no lock of another thread
                child = os.fork()
                if not child:
                    _answer(compute, writes)
        finally:
            os.close(writes)
        while not select([reads], [], [], LOOK_S)[0]:
            pass
        with open(reads, "rb", closefd=False) as file:
            said = file.read()
    finally:
        if child:
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
