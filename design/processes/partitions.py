"""Partitions of the sojourn time into sections, one scheduled gain (or one Lyapunov cell) each.

A partition is a tuple of section starts per mode, 0 = h_0 < h_1 < ... < h_{M-1}; section m is [h_{m-1}, h_m), the last
one never ends. Strategies: equal probability (2.22), uniform (2.23), rate threshold (2.24).

The form of the Lyapunov function matters more than the partition: `hil reproduce ch2`, certified scales and Remark 2.2.
"""

from __future__ import annotations

import math

import numpy as np

from design.errors import FieldError
from design.processes.elementary import log1p
from design.processes.semi_markov import SemiMarkov

Partition = tuple[tuple[float, ...], ...]


def _sections(sections: int) -> None:
    if sections < 1:
        raise FieldError("sections", f"{sections}, expected at least 1")


def _end(process: SemiMarkov, mode: int, end_s: float | None) -> float:
    end = process.settled(mode) if end_s is None else end_s
    if not math.isfinite(end) or end < 0 or (end == 0 and end_s is not None):
        raise FieldError("end_s", f"the rates out of mode {mode} have no limit, give end (got {end!r})")
    return end


def check_partition(process: SemiMarkov, starts: Partition) -> None:
    """Raise ValueError unless there is one increasing tuple of finite section starts from 0 per mode."""
    if len(starts) != process.modes:
        raise FieldError("partition", f"{len(starts)} tuples of section starts for {process.modes} modes")
    for mode, row in enumerate(starts):
        if not row or row[0] != 0.0 or not np.isfinite(row).all() or (np.diff(row) <= 0).any():
            raise FieldError(f"partition[{mode}]", f"{row} is not 0 = h_0 < h_1 < ...")


def equal_probability(process: SemiMarkov, sections: int) -> Partition:
    """Sections that a sojourn ends in with equal probability, Pr{h_{m-1} <= h < h_m} = 1/M (2.22).

    >>> from design.processes.rates import WeibullRate
    >>> rate = WeibullRate(scale_s=1.0, shape=2.0)
    >>> equal_probability(SemiMarkov(rates=((None, rate), (rate, None))), 2)[0]
    (0.0, 0.8325546111576977)
    """
    _sections(sections)
    levels = -log1p(-np.arange(sections) / sections)
    out = []
    for mode in range(process.modes):
        starts = process.sojourn(mode, levels)
        if not np.isfinite(starts).all():
            starts = starts[np.isfinite(starts)]
            if starts.size < sections and process.targets(mode):
                raise FieldError("sections", f"mode {mode} is left with a probability below {1 - 1 / sections:g}")
        out.append(tuple(starts.tolist()))
    return tuple(out)


def uniform(process: SemiMarkov, sections: int, end_s: float | None = None) -> Partition:
    """Sections of equal length up to ``end_s``, by default where the rates settle (2.23)."""
    _sections(sections)
    ends = [_end(process, mode, end_s) for mode in range(process.modes)]
    return tuple(tuple((end * np.arange(sections if end > 0 else 1) / sections).tolist()) for end in ends)


def rate_threshold(process: SemiMarkov, threshold: float, *, most: int = 1000) -> Partition:
    """Sections as long as they can be on which no rate changes by more than a threshold (2.24).

    Args:
        process: whose rates settle.
        threshold: largest change of any rate within a section, 1/s.
        most: sections of a mode.

    Raises:
        FieldError: the threshold is not positive, a rate jumps by more, or a mode takes more sections.
    """
    if not threshold > 0.0:
        raise FieldError("threshold", f"{threshold!r}, expected a rate above 0")
    return tuple(tuple(_steps(process, mode, threshold, most)) for mode in range(process.modes))


def _steps(process: SemiMarkov, mode: int, threshold: float, most: int) -> list[float]:
    def fits(start: float, stop: float) -> bool:
        low, high = process.bounds(mode, start, stop)
        return bool((high - low <= threshold).all())

    starts, end = [0.0], _end(process, mode, None)
    while not fits(starts[-1], end):
        short, long = starts[-1], end
        for _ in range(60):  # the longest section from here, to the last bit of a few seconds
            middle = 0.5 * (short + long)
            short, long = (middle, long) if fits(starts[-1], middle) else (short, middle)
        if short <= starts[-1] or len(starts) == most:
            raise FieldError("threshold", f"{threshold:g}: mode {mode} takes more than {most} sections, or its rate jumps")
        starts.append(short)
    return starts
