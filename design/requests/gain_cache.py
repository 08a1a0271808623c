"""Scheduled gains and gains over historical data, kept between runs: the same request is solved once per machine.

Only gains are taken from the cache. The loop that runs with them is certified as any other, so that a damaged or forged entry
can at worst cost a refusal.
"""

from __future__ import annotations

import hashlib
import json
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from design.controllers.scheduled_gain import ScheduledGain
from design.errors import FieldError
from design.tracking.design_file import cache_directory, keep_entry, read_json

G = TypeVar("G")

SOLVER_VERSION = 1
"""Raise it whenever a synthesis of Chapters 2 to 5 may return other gains for the same request."""


def cached_gain(request: object, solve: Callable[[], ScheduledGain], directory: Path | None = None) -> ScheduledGain:
    """Return the gains that belong to a request, from the cache or solved.

    Args:
        request: all that decides the gains; what cannot be pickled is solved every time.
        solve: computes them.
        directory: where entries lie; default `design.tracking.design_file.cache_directory`. One that cannot be read or
            written is no error.

    Raises:
        DesignError: as ``solve``.
    """

    def read(stored: dict[str, Any]) -> ScheduledGain:
        return ScheduledGain(
            gain=np.array(stored["gain"], dtype=np.float64), starts_s=np.array(stored["starts_s"], dtype=np.float64),
            schedule=stored["schedule"], measured=tuple(map(str, stored["measured"])),
        )  # fmt: skip

    def written(found: ScheduledGain) -> dict[str, Any]:
        return {
            "gain": found.gain.tolist(), "starts_s": found.starts_s.tolist(), "schedule": found.schedule,
            "measured": list(found.measured),
        }  # fmt: skip

    return _kept("scheduled", request, solve, read, written, directory)


def cached_history(
    request: object, solve: Callable[[], NDArray[np.float64]], directory: Path | None = None
) -> NDArray[np.float64]:
    """Return the gains over historical data, K[phase, j, m, p], that belong to a request; all as in `cached_gain`."""

    def read(stored: dict[str, Any]) -> NDArray[np.float64]:
        K = np.array(stored["gains"], dtype=np.float64)
        if K.ndim != 4 or not np.isfinite(K).all():
            raise FieldError("gains", "expected finite numbers [phase][j][m][p]")
        return K

    return _kept("historical", request, solve, read, lambda K: {"gains": K.tolist()}, directory)


def _kept(
    kind: str,
    request: object,
    solve: Callable[[], G],
    read: Callable[[dict[str, Any]], G],
    written: Callable[[G], dict[str, Any]],
    directory: Path | None,
) -> G:
    directory = directory or cache_directory()
    try:
        digest = hashlib.sha256(pickle.dumps((SOLVER_VERSION, request), protocol=5)).hexdigest()
    except (pickle.PicklingError, AttributeError, TypeError):
        return solve()
    if directory is None:
        return solve()
    entry = directory / f"{kind}-{digest}.json"
    try:
        return read(read_json(entry))
    except (ValueError, KeyError, TypeError, OverflowError):
        pass
    found = solve()
    try:
        keep_entry(entry, json.dumps(written(found)))
    except OSError:
        pass
    return found
