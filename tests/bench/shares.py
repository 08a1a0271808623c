"""Two shares of few events, as of late answers: their ratio, and between what it lies."""

from __future__ import annotations

import math
from typing import Final

from tests.bench.figure import Found

LEVEL: Final = 0.95


def of_shares(name: str, ours: tuple[int, int], peer: tuple[int, int], note: str = "") -> Found:
    """Return a figure in percent, with what its ratio lies between.

    Args:
        name: of the figure.
        ours, peer: so many events, of so many.
        note: what else there is to say.

    >>> of_shares("late", (2, 16_000), (3, 16_000)).note
    '2 of 16000 against 3 of 16000, ratio between 0.056 and 5.8'
    """
    low, high = ratio_interval(ours, peer)
    reported = f"{ours[0]} of {ours[1]} against {peer[0]} of {peer[1]}, ratio between {low:.2g} and {high:.2g}"
    note = "; ".join(filter(None, (note, reported)))
    return Found(name, 100 * ours[0] / ours[1], 100 * peer[0] / peer[1], note, between=(low, high))


def ratio_interval(ours: tuple[int, int], peer: tuple[int, int]) -> tuple[float, float]:
    """Return between what the ratio of two rates lies, with 95 % confidence, if events come one by one.

    Of all events of both, ours are binomial: their share is that of ours in the sum of both rates (Przyborowski and Wilenski
    1940), whose exact interval is that of Clopper and Pearson. Events that come in bursts make the true interval wider.

    >>> [round(float(v), 3) for v in ratio_interval((0, 1000), (30, 1000))]
    [0.0, 0.131]
    """
    from scipy.stats import binomtest

    events = ours[0] + peer[0]
    if not events:
        return 0.0, math.inf
    low, high = binomtest(ours[0], events).proportion_ci(LEVEL)
    often = peer[1] / ours[1]
    return often * low / (1.0 - low) if low < 1.0 else math.inf, often * high / (1.0 - high) if high < 1.0 else math.inf
