"""How well the rig kept its times, and whether that is good enough to believe the run."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

Array: TypeAlias = npt.NDArray[Any]

OVERRUN_SHARE = 1e-3
"""Largest share of overruns in a valid run."""

LATE_SHARE = 1e-3
"""Largest share of slots without an answer in time in a valid run."""

LATENESS_SHARE = 0.1
"""Largest p99 lateness of a valid run, as a share of the period: a sampling instant is then known to a tenth of T."""


def timing_metrics(lateness_us: Array, round_trip_us: Array, late: Array, overrun: Array, *, period_s: float) -> dict[str, Any]:
    """Return the timing part of a summary, with its verdict.

    A run is valid when at most 0.1 % of its slots overran, at most 0.1 % had no answer in time, and the p99 of the
    lateness is at most a tenth of the period. A virtual run (no ticks timed) is valid: its times are exact.

    Args:
        lateness_us: wake-up after the nominal time in us, (n,).
        round_trip_us: sensor frame out to control frame in, in us, (n,), NaN where none came.
        late, overrun: 0 or 1 (or counts) per slot, (n,).
        period_s: sample period in s.

    Returns:
        valid, why (the reasons against it), lateness_us and round_trip_us (p50, p99, p99_9, max; None without samples), late,
        overruns, first_late_slot (index of the first slot that was late, None if none was).

    >>> timing_metrics(np.array([10.0, 12.0]), np.array([80.0, np.nan]), np.array([0, 1]), np.zeros(2), period_s=1e-3)["why"]
    ['1 of 2 slots had no answer in time']
    """
    n = len(lateness_us)
    late_count, overruns = int(np.sum(late)), int(np.sum(overrun))
    lateness = percentiles(lateness_us)
    why = []
    if n and late_count > LATE_SHARE * n:
        why.append(f"{late_count} of {n} slots had no answer in time")
    if n and overruns > OVERRUN_SHARE * n:
        why.append(f"{overruns} of {n} slots overran")
    p99 = lateness["p99"]
    if p99 is not None and p99 > LATENESS_SHARE * period_s * 1e6:
        why.append(f"p99 of the lateness is {p99:.0f} us, above a tenth of the period")
    missed = np.flatnonzero(late)
    return {
        "valid": not why,
        "why": why,
        "lateness_us": lateness,
        "round_trip_us": percentiles(round_trip_us),
        "late": late_count,
        "overruns": overruns,
        "first_late_slot": int(missed[0]) if missed.size else None,
    }


def percentiles(values: Array) -> dict[str, float | None]:
    """Return p50, p99, p99_9 and max of the finite values, None where there are none."""
    finite = np.asarray(values, dtype=np.float64)
    finite = finite[np.isfinite(finite)]
    if not finite.size:
        return dict.fromkeys(("p50", "p99", "p99_9", "max"))
    p50, p99, p99_9, most = np.percentile(finite, (50, 99, 99.9, 100))
    return {"p50": float(p50), "p99": float(p99), "p99_9": float(p99_9), "max": float(most)}
