"""Chapter 5 as printed: the gains of Section 5.4, and Theorem 5.1, which its own example cannot meet."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def historical_gains() -> Array:
    """The printed gains (5.16), (4, 6, 1, 4): sensor i + 1 has just sent, x(k - j).

    The plant that they are for is `plants.delayed_states`.
    """
    rows = [
        [
            [0.0077, 0.0, 0.0, 0.0],
            [0.0213, 0.0, 0.0, 0.0102],
            [0.0285, 0.0, -0.0008, 0.0412],
            [0.0, -0.1363, 0.0908, -0.2066],
            [0.0613, 0.0929, -0.1737, 0.0],
            [0.0264, -0.0201, 0.0, -0.0329],
        ],
        [
            [0.0, -0.0955, 0.0, 0.0],
            [0.0161, -0.0366, 0.0, 0.0],
            [0.0407, 0.0467, 0.0, 0.0537],
            [0.006, 0.0, 0.0975, -0.3191],
            [0.0, 0.1049, -0.1654, -0.1838],
            [0.024, -0.0322, -0.0087, 0.0],
        ],
        [
            [0.0, 0.0, 0.0044, 0.0],
            [0.0, -0.0602, 0.0819, 0.0],
            [0.0431, 0.0482, 0.0335, 0.0],
            [-0.0199, -0.1363, 0.0, -0.2093],
            [0.0532, 0.0, -0.1446, -0.1115],
            [0.0, -0.0235, -0.0106, -0.0113],
        ],
        [
            [0.0, 0.0, 0.0, 0.1798],
            [0.0, 0.0, 0.0863, -0.0107],
            [0.0, 0.0168, 0.0305, 0.1038],
            [-0.0318, -0.1771, 0.0905, 0.0],
            [0.1151, 0.1491, 0.0, -0.2225],
            [0.0293, 0.0, -0.0018, -0.0584],
        ],
    ]
    return np.array(rows)[:, :, None, :]


def newest_gains() -> Array:
    """The printed gains (5.17) of the comparison, which use the newest sample only, (4, 1, 1, 4)."""
    return np.diag([-0.7615, -1.1651, 1.6105, 0.7005])[:, None, None, :]


def printed_functional(P: Array, Q: Array, history: Sequence[Array]) -> float:
    """Return V(0) as printed, with the sum over h from j - tau - 1 to -1. NOT SOUND with a history that is not zero.

    Args:
        P: (n, n).
        Q: (tau, n, n).
        history: x(0), x(-1), ...; what is not given is zero.
    """
    x, tau = [np.asarray(each, dtype=float) for each in history], len(Q)
    past = sum(x[-h] @ Q[j - 1] @ x[-h] for j in range(1, tau + 1) for h in range(j - tau - 1, 0) if -h < len(x))
    return float(x[0] @ P @ x[0] + past)


def stabilising_intervals(A: Array, B: Array, state: int) -> list[tuple[float, float]]:
    """Return the open intervals of k for which A + B k e' is Schur stable, e the unit vector of one state.

    Block (0, 0) of (5.9) needs (A + B K(i,0))' P (A + B K(i,0)) < P - sum Q_j - Xi < P: A + B K(i,0) must be Schur stable for
    every phase i, whatever P. The zero-element constraints (5.8) leave one number in K(i,0), so that the set of stabilising
    numbers is a set of intervals that can be computed; where it is empty the theorem is infeasible for every controller.

    The characteristic polynomial is linear in k. A root crosses the unit circle only where it is 1, -1 or a pair e^(+-it):
    at finitely many k. Between two neighbouring ones nothing changes, so that one k of each interval decides all of it.

    Args:
        A: (n, n).
        B: (n, 1).
        state: the column that k acts on, from 0.
    """
    n = len(A)
    plain = np.poly(A).astype(np.float64)
    slope = np.poly(A + B @ np.eye(n)[state : state + 1]).astype(np.float64) - plain
    crossings = _crossings(plain, slope)
    ends = [-np.inf, *sorted(set(crossings)), np.inf]
    found = []
    for low, high in pairwise(ends):
        inside = 0.5 * (low + high) if np.isfinite([low, high]).all() else (high - 1.0 if np.isfinite(high) else low + 1.0)
        if not np.isfinite([low, high]).any():
            inside = 0.0
        if np.abs(np.roots(plain + inside * slope)).max() < 1.0:
            found.append((float(low), float(high)))
    return found


def _crossings(plain: Array, slope: Array) -> list[float]:
    """Numbers k at which plain(z) + k slope(z) has a root on the unit circle."""
    # k = -plain(z)/slope(z) is real on |z| = 1 where plain(z) slope(1/z) is: an equation in z and 1/z, made a polynomial.
    product = np.convolve(plain, slope[::-1]) - np.convolve(plain[::-1], slope)
    points = [1.0 + 0j, -1.0 + 0j]
    if np.abs(product).max() > 0.0:
        roots = np.roots(product)
        points += [z / abs(z) for z in roots if abs(abs(z) - 1.0) < 1e-5]
    below = [np.polyval(slope, z) for z in points]
    return [float((-np.polyval(plain, z) / s).real) for z, s in zip(points, below) if abs(s) > 1e-12]
