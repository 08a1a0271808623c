"""Solved designs, kept between runs: the same problem is solved once per machine.

Only the gains are taken from the cache. Their certificate is computed again, so that a damaged or forged entry can at
worst cost the time of solving.
"""

from __future__ import annotations

import json
import os
import secrets
from pathlib import Path

import numpy as np

from design.errors import DesignError
from design.tracking.json_file import read_json
from design.tracking.problem import TrackingProblem
from design.tracking.synthesis import Design, Progress, certified, solve

SOLVER_VERSION = 3
"""Raise it whenever `design.tracking.synthesis.solve` may return other gains for the same problem."""


def cache_directory() -> Path | None:
    """$XDG_CACHE_HOME/hilrig/designs, or ~/.cache/hilrig/designs; None for a user without a home."""
    root = os.environ.get("XDG_CACHE_HOME", "")
    try:
        return (Path(root) if os.path.isabs(root) else Path.home() / ".cache") / "hilrig" / "designs"
    except RuntimeError:  # neither HOME nor an entry in passwd: a container's unknown user
        return None


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
    directory = directory or cache_directory()
    if directory is None:
        return solve(problem, progress=progress)
    entry = directory / f"{problem.digest()}-{SOLVER_VERSION}.json"
    found = kept_design(entry, problem)
    if found is not None:
        return found
    design = solve(problem, progress=progress)
    document = {
        "gains": design.gains.tolist(),
        "starts": [v if np.isfinite(v) else None for v in design.starts],
        "evaluations": design.evaluations,
    }
    try:
        keep_entry(entry, json.dumps(document))
    except OSError:
        pass
    return design


def kept_design(entry: Path, problem: TrackingProblem) -> Design | None:
    """Return the design of an entry, certified again; None for whatever is none of this problem."""
    try:
        stored = read_json(entry)
        gains = np.array(stored["gains"], dtype=np.float64)
        starts = tuple(np.inf if v is None else float(v) for v in stored["starts"])
        with np.errstate(over="ignore", invalid="ignore"):  # gains that were damaged make a loop that is not stable
            return certified(problem, gains, starts=starts, evaluations=int(stored["evaluations"]))
    except (ValueError, KeyError, TypeError, OverflowError, np.linalg.LinAlgError, DesignError):
        return None


def keep_entry(entry: Path, text: str) -> None:
    """Put an entry in its place in one step, through no link of anybody's, readable for its user alone."""
    entry.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    part = entry.with_suffix(f".{secrets.token_hex(6)}.part")
    try:
        with open(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600), "w") as file:
            file.write(text)
        part.replace(entry)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
