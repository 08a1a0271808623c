"""Rates of a fault and of its detection, from both modes over time: jumps counted over the time at risk.

In mode i, after a sojourn h within [a, b), n jumps to j in a time T at risk give the rate n / T, and the exact interval of a
Poisson count,

    chi2(0.025; 2 n) / (2 T)  to  chi2(0.975; 2 n + 2) / (2 T).

The rates of detection are counted apart for every true mode (4.2). Modes are known at samples, and the sojourn to a sample: a
stay that no sample falls into hides two jumps, or shows them as one. With q_i = sum_j q_ij, to first order in the period, a share
(q_i + q_j) period / 2 of the jumps from i to j is hidden, by which the upper bound is larger, and sum_k q_ik q_kj period / 2 is
the rate of what looks like them, by which the lower one is smaller: q_i after the sojourn, q_j and q_kj after the shortest.

Reference: thesis sec. 4.2; O. O. Aalen, Nonparametric inference for a family of counting processes, Ann. Stat. 6(4), 1978.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from design.errors import DesignError, FieldError
from design.identification import Array

LEVEL: Final = 0.95
FASTEST: Final = 0.1
"""Jumps per sample up to which the bounds hold: with more, jumps are missed in all orders."""
Modes = NDArray[np.int64]


class ModeRecord(NamedTuple):
    """True and detected mode (n,), counted from 1, at samples a period in s apart; both sojourns are 0 at the first one."""

    fault: Modes
    detected: Modes
    period_s: float


class JumpRate(NamedTuple):
    """A rate in 1/s of a jump from one mode to another after a sojourn from `after_s` to `before_s`, with its 95 % interval.

    `fault` is the true mode during which a detected mode jumps, None for jumps of the true mode; `jumps` were counted in
    `exposure_s`.
    """

    fault: int | None
    source: int
    to: int
    after_s: float
    before_s: float
    jumps: int
    exposure_s: float
    rate: float
    low: float
    high: float


def jump_rates(records: Sequence[ModeRecord], edges_s: Sequence[float] = (), *, restarts: bool = False) -> list[JumpRate]:
    """Return every rate out of a mode that was seen, those of the fault first.

    Args:
        records: of one process.
        edges_s: sojourns above 0 in s, rising, between which the rate is taken as one; none: one rate for all sojourns.
        restarts: whether a jump of the fault sets the sojourn of the detected mode to 0.

    Raises:
        FieldError: edges that do not rise, or a record of fewer than two samples.
        DesignError: so few samples that jumps are missed.
    """
    edges = np.array([0.0, *edges_s, np.inf])
    if not (np.diff(edges) > 0.0).all():
        raise FieldError("edges", f"{list(edges_s)}, expected sojourns above 0 s, rising")
    if not records or min(len(record.fault) for record in records) < 2:
        raise FieldError("records", "fewer than two samples, expected more")
    faults, detected = (int(max(getattr(record, name).max() for record in records)) for name in ("fault", "detected"))
    of_fault = np.zeros((1, faults, faults, len(edges) - 1))
    of_detected = np.zeros((faults, detected, detected, len(edges) - 1))
    for record in records:
        fault_jumps = np.diff(record.fault) != 0
        detected_jumps = np.diff(record.detected) != 0
        _count(of_fault, np.ones_like(record.fault), record.fault, fault_jumps, record.period_s, edges)
        cleared = detected_jumps | fault_jumps if restarts else detected_jumps
        _count(of_detected, record.fault, record.detected, cleared, record.period_s, edges)
    period_s = max(record.period_s for record in records)
    found = [*_rates(of_fault, edges, period_s, known=False), *_rates(of_detected, edges, period_s, known=True)]
    fastest = max((each.low for each in found), default=0.0) * period_s
    if fastest > FASTEST:
        said = f"{fastest:.3g} jumps per sample and more, expected at most {FASTEST:g}: beyond, jumps are missed"
        raise DesignError(said, value=fastest)
    return found


def _count(into: Array, given: Modes, modes: Modes, cleared: NDArray[np.bool_], period_s: float, edges: Array) -> None:
    """Add, per (given, from, to, sojourn), the jumps; and where to is from, the time at risk in s."""
    k = np.arange(len(cleared))
    since = np.maximum.accumulate(np.where(np.r_[False, cleared[:-1]], k, 0))  # the sample at which the sojourn began
    sojourn = (k - since + 0.5) * period_s
    at = np.searchsorted(edges, sojourn, side="right") - 1
    source, to = modes[:-1] - 1, modes[1:] - 1
    jumps = source != to
    np.add.at(into, (given[:-1] - 1, source, source, at), period_s)
    np.add.at(into, (given[:-1][jumps] - 1, source[jumps], to[jumps], at[jumps]), 1.0)


def _rates(counted: Array, edges: Array, period_s: float, *, known: bool) -> list[JumpRate]:
    from scipy.special import chdtri

    alone = np.eye(counted.shape[1], dtype=bool)

    def rates(part: Array) -> Array:
        return np.where(alone, 0.0, part / np.maximum(part.diagonal(axis1=1, axis2=2)[:, :, None], period_s))

    by_stay, found = [rates(part) for part in np.moveaxis(counted, 3, 0)], []
    fresh = np.maximum(by_stay[0], rates(counted.sum(axis=3)))
    for given, source, to, at in np.ndindex(*counted.shape):
        exposure, n = float(counted[given, source, source, at]), round(float(counted[given, source, to, at]))
        hidden = 0.5 * period_s * float(by_stay[at][given, source].sum() + fresh[given, to].sum())
        through = 0.5 * period_s * float(by_stay[at][given, source] @ fresh[given, :, to])
        if source == to or not exposure:
            continue
        low = float(chdtri(2 * n, (1.0 + LEVEL) / 2.0)) / (2.0 * exposure) if n else 0.0
        high = float(chdtri(2 * n + 2, (1.0 - LEVEL) / 2.0)) / (2.0 * exposure)
        low = max(low - through, 0.0)
        high /= 1.0 - min(hidden, 0.5)
        fault = given + 1 if known else None
        ends = float(edges[at]), float(edges[at + 1])
        found.append(JumpRate(fault, source + 1, to + 1, *ends, n, exposure, n / exposure, low, high))
    return found
