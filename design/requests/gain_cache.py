"""Scheduled gains, kept between runs: the same plant and the same request are solved once per machine.

Only gains are taken from the cache. The loop that runs with them is certified as any other, so that a damaged or forged entry
can at worst cost a refusal.
"""

from __future__ import annotations

import hashlib
import json
import pickle
from collections.abc import Callable
from pathlib import Path

import numpy as np

from design.controllers.scheduled_gain import ScheduledGain
from design.tracking.cache import cache_directory, keep_entry
from design.tracking.json_file import read_json

SOLVER_VERSION = 1
"""Raise it whenever a synthesis of Chapters 2 to 4 may return other gains for the same request."""


def cached_gain(request: object, solve: Callable[[], ScheduledGain], directory: Path | None = None) -> ScheduledGain:
    """Return the gains that belong to a request, from the cache or solved.

    Args:
        request: all that decides the gains; what cannot be pickled is solved every time.
        solve: computes them.
        directory: where entries lie; default `design.tracking.cache.cache_directory`. One that cannot be read or written is no
            error.

    Raises:
        DesignError: as ``solve``.
    """
    directory = directory or cache_directory()
    try:
        digest = hashlib.sha256(pickle.dumps((SOLVER_VERSION, request), protocol=5)).hexdigest()
    except (pickle.PicklingError, AttributeError, TypeError):
        return solve()
    if directory is None:
        return solve()
    entry = directory / f"scheduled-{digest}.json"
    try:
        stored = read_json(entry)
        return ScheduledGain(
            gain=np.array(stored["gain"], dtype=np.float64), starts_s=np.array(stored["starts_s"], dtype=np.float64),
            schedule=stored["schedule"], measured=tuple(map(str, stored["measured"])),
        )  # fmt: skip
    except (ValueError, KeyError, TypeError, OverflowError):
        pass
    found = solve()
    document = {
        "gain": found.gain.tolist(), "starts_s": found.starts_s.tolist(), "schedule": found.schedule,
        "measured": list(found.measured),
    }  # fmt: skip
    try:
        keep_entry(entry, json.dumps(document))
    except OSError:
        pass
    return found
