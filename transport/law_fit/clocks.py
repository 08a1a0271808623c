"""Two clocks: how fast one runs away from the other, and how far apart they are, from time stamps alone.

A packet sent at s of one clock came at r of the other: r - s = L + offset + drift s, L >= least latency. The smallest of r - s
in each of 32 pieces of the record lie near a line, whose slope is the drift (Paxson 1998), by the median of Theil and Sen;
whether there is one says Kendall's rank test. The offset cannot be seen in one direction: of both it is half the difference
of the smallest ones, if the least latency is the same in both.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

Array = NDArray[np.float64]

PIECES = 32
SEEN = 1e-5
"""A slope is a drift where chance alone gives it with less than this probability."""


class Drift(NamedTuple):
    """Of the receiver's clock against the sender's, s per s, with the half width of its 95 % interval; whether it is seen."""

    slope: float
    half_width: float
    seen: bool


def drift_of(sent_s: Array, difference_s: Array) -> Drift:
    """Estimate the drift between two clocks.

    Args:
        sent_s: (n,) instants at the sender's clock.
        difference_s: (n,) received minus sent, NaN of what did not come.
    """
    span = float(sent_s[-1] - sent_s[0])
    piece = (
        np.minimum(((sent_s - sent_s[0]) / span * PIECES).astype(np.int64), PIECES - 1)
        if span > 0.0
        else np.zeros(len(sent_s), int)
    )
    at, least = [], []
    for number in range(PIECES):
        here = np.flatnonzero((piece == number) & ~np.isnan(difference_s))
        if len(here):
            lowest = int(here[difference_s[here].argmin()])
            at.append(sent_s[lowest])
            least.append(difference_s[lowest])
    if len(at) < PIECES // 2:
        return Drift(0.0, np.inf, False)
    line = stats.theilslopes(least, at, alpha=0.95)
    seen = float(stats.kendalltau(at, least).pvalue) < SEEN
    return Drift(float(line.slope), 0.5 * float(line.high_slope - line.low_slope), seen)


def without_drift(sent_s: Array, difference_s: Array, drift: Drift) -> Array:
    """Return received minus sent as if both clocks ran alike; the first difference stays as it was.

    Args:
        sent_s, difference_s: see `drift_of`.
        drift: what was estimated.
    """
    return np.asarray(difference_s - drift.slope * (sent_s - sent_s[0]), dtype=np.float64)


def offset_of(there_s: Array, back_s: Array) -> float:
    """Return how far the other clock is ahead, s, if the least latency is the same in both directions.

    Args:
        there_s: received (other clock) minus sent (ours), NaN of what did not come.
        back_s: received (ours) minus sent (other clock).
    """
    return 0.5 * (float(np.nanmin(there_s)) - float(np.nanmin(back_s)))
