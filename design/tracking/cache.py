"""Solved designs, kept between runs: the same problem is solved once per machine.

Only the gains are taken from the cache. Their certificate is computed again, so that a damaged or forged entry can at
worst cost the time of solving.
"""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np

from design.errors import DesignError
from design.tracking.problem import TrackingProblem
from design.tracking.synthesis import Design, Progress, certified, solve

SOLVER_VERSION = 3
"""Raise it whenever `design.tracking.synthesis.solve` may return other gains for the same problem."""


def cache_directory() -> Path:
    """$XDG_CACHE_HOME/hilrig/designs, or ~/.cache/hilrig/designs."""
    root = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(root) if os.path.isabs(root) else Path.home() / ".cache") / "hilrig" / "designs"


def solve_cached(
    problem: TrackingProblem, *, directory: Path | None = None, progress: Progress | None = None
) -> Design:
    """Solve a problem, or take its gains from the cache and certify them again.

    Args:
        problem: what is asked.
        directory: where entries lie; default `cache_directory()`. A cache that cannot be read or written is no error.

    Raises:
        NotStable, Infeasible: as `design.tracking.synthesis.solve`.
    """
    entry = (directory or cache_directory()) / f"{problem.digest()}-{SOLVER_VERSION}.json"
    try:
        stored = json.loads(entry.read_text(encoding="utf-8"))
        gains = np.array(stored["gains"], dtype=np.float64)
        starts = tuple(np.inf if v is None else float(v) for v in stored["starts"])
        return certified(problem, gains, starts=starts, evaluations=int(stored["evaluations"]))
    except (OSError, ValueError, KeyError, TypeError, RecursionError, DesignError):
        pass
    design = solve(problem, progress=progress)
    document = {
        "gains": design.gains.tolist(),
        "starts": [v if np.isfinite(v) else None for v in design.starts],
        "evaluations": design.evaluations,
    }
    try:
        entry.parent.mkdir(parents=True, exist_ok=True)
        temporary = entry.with_suffix(f".{os.getpid()}.part")
        temporary.write_text(json.dumps(document), encoding="utf-8")
        temporary.replace(entry)
    except OSError:
        pass
    return design
