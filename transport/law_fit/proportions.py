"""Confidence intervals of probabilities: Wilson's of counts, Clopper and Pearson's for guarantees, Wald's of logits."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special, stats

Array = NDArray[np.float64]

LEVEL = 0.95


class Interval(NamedTuple):
    """Both ends."""

    low: float
    high: float


def wilson(count: float, n: float, level: float = LEVEL) -> Interval:
    """Return Wilson's interval (1927) of a probability, of which `count` in `n` were seen.

    >>> [round(end, 4) for end in wilson(10, 100)]
    [0.0552, 0.1744]
    """
    if n <= 0:
        return Interval(0.0, 1.0)
    z = float(stats.norm.ppf(0.5 + level / 2.0))
    p = count / n
    middle, half = p + z * z / (2 * n), z * float(np.sqrt(p * (1.0 - p) / n + z * z / (4 * n * n)))
    low, high = (middle - half) / (1.0 + z * z / n), (middle + half) / (1.0 + z * z / n)
    return Interval(0.0 if count == 0 else max(0.0, low), 1.0 if count == n else min(1.0, high))


def clopper_pearson(count: Array, n: Array, miss: float) -> tuple[Array, Array]:
    """Return intervals that hold with probability 1 - `miss` at least, each, whatever the probability (1934).

    Args:
        count: how often it was seen; need not be whole.
        n: of how many.
        miss: probability of an interval that does not hold.
    """
    low = np.where(count > 0, special.betaincinv(np.maximum(count, 1e-12), n - count + 1.0, miss / 2.0), 0.0)
    high = np.where(count < n, special.betaincinv(count + 1.0, np.maximum(n - count, 1e-12), 1.0 - miss / 2.0), 1.0)
    return np.asarray(low), np.asarray(high)


def wald_logit(cost: Callable[[Array], float], at: Array, names: Sequence[str], step: float = 0.02) -> dict[str, Interval]:
    """Return intervals from the observed information, on logits, where a log-likelihood is near a paraboloid.

    Args:
        cost: minus the log-likelihood of logits (m,).
        at: its minimum, (m,).
        names: of the parameters.
        step: of the differences.
    """
    m = len(at)
    hessian = np.empty((m, m))
    steps = np.eye(m) * step
    for i in range(m):
        for j in range(i, m):
            corners = (cost(at + a * steps[i] + b * steps[j]) * a * b for a in (-1, 1) for b in (-1, 1))
            hessian[i, j] = hessian[j, i] = sum(corners) / (4.0 * step * step)
    try:
        variance = np.linalg.inv(hessian).diagonal()
    except np.linalg.LinAlgError:
        return {}
    z = float(stats.norm.ppf(0.5 + LEVEL / 2.0))
    at_an_end = 12.0  # there a logit has no interval
    return {
        name: Interval(*special.expit([x - z * s, x + z * s]).tolist())
        for name, x, s in zip(names, at.tolist(), np.sqrt(np.where(variance > 0.0, variance, np.inf)).tolist())
        if abs(x) < at_an_end
    }
