"""Gains that were solved for, kept between runs: the same request is solved once per machine.

Only gains are taken from the cache. What is claimed of them is computed again, so that a damaged or forged entry can at worst
cost the time of solving, or a refusal.
"""

from __future__ import annotations

import hashlib
import json
import os
import pickle
import secrets
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from design.controllers.scheduled_gain import ScheduledGain
from design.errors import DesignError, FieldError
from design.tracking import TrackingProblem
from design.tracking.design_file import read_json
from design.tracking.synthesis import Design, certified, solve

G = TypeVar("G")
Stored = dict[str, Any]

TRACKING_VERSION = 3
"""Raise it whenever `design.tracking.synthesis.solve` may return other gains for the same problem."""

SCHEDULED_VERSION = 1
"""Raise it whenever a synthesis of Chapters 2 to 5 may return other gains for the same request."""


def cache_directory() -> Path | None:
    """$XDG_CACHE_HOME/hilrig/designs, or ~/.cache/hilrig/designs; None for a user without a home."""
    root = os.environ.get("XDG_CACHE_HOME", "")
    try:
        return (Path(root) if os.path.isabs(root) else Path.home() / ".cache") / "hilrig" / "designs"
    except RuntimeError:  # neither HOME nor an entry in passwd: a container's unknown user
        return None


def solve_cached(problem: TrackingProblem, *, directory: Path | None = None) -> Design:
    """Solve a problem, or take its gains from the cache and certify them again.

    Args:
        problem: what is asked.
        directory: where entries lie; default `cache_directory()`. A cache that cannot be read or written is no error.

    Raises:
        NotStable, Infeasible: as `design.tracking.synthesis.solve`.
    """

    def written(design: Design) -> Stored:
        return {
            "gains": design.gains.tolist(), "starts": [v if np.isfinite(v) else None for v in design.starts],
            "evaluations": design.evaluations,
        }  # fmt: skip

    name = f"{problem.digest()}-{TRACKING_VERSION}"
    return _kept(name, lambda: solve(problem), lambda stored: design_of(stored, problem), written, directory)


def design_of(stored: Stored, problem: TrackingProblem) -> Design:
    """Return the design of an entry, certified again.

    Raises:
        ValueError, KeyError, TypeError, OverflowError, LinAlgError, DesignError: it is none of this problem.
    """
    gains = np.array(stored["gains"], dtype=np.float64)
    starts = tuple(np.inf if v is None else float(v) for v in stored["starts"])
    with np.errstate(over="ignore", invalid="ignore"):  # gains that were damaged make a loop that is not stable
        return certified(problem, gains, starts=starts, evaluations=int(stored["evaluations"]))


def cached_gain(request: object, solve: Callable[[], ScheduledGain], directory: Path | None = None) -> ScheduledGain:
    """Return the gains that belong to a request, from the cache or solved.

    Args:
        request: all that decides the gains; what cannot be pickled is solved every time.
        solve: computes them.
        directory: as of `solve_cached`.

    Raises:
        DesignError: as ``solve``.
    """

    def read(stored: Stored) -> ScheduledGain:
        return ScheduledGain(
            gain=np.array(stored["gain"], dtype=np.float64), starts_s=np.array(stored["starts_s"], dtype=np.float64),
            schedule=stored["schedule"], measured=tuple(map(str, stored["measured"])),
        )  # fmt: skip

    def written(found: ScheduledGain) -> Stored:
        return {
            "gain": found.gain.tolist(), "starts_s": found.starts_s.tolist(), "schedule": found.schedule,
            "measured": list(found.measured),
        }  # fmt: skip

    return _kept(_name("scheduled", request), solve, read, written, directory)


def cached_history(
    request: object, solve: Callable[[], NDArray[np.float64]], directory: Path | None = None
) -> NDArray[np.float64]:
    """Return the gains over historical data, K[phase, j, m, p], that belong to a request; all as in `cached_gain`."""

    def read(stored: Stored) -> NDArray[np.float64]:
        K = np.array(stored["gains"], dtype=np.float64)
        if K.ndim != 4 or not np.isfinite(K).all():
            raise FieldError("gains", "expected finite numbers [phase][j][m][p]")
        return K

    return _kept(_name("historical", request), solve, read, lambda K: {"gains": K.tolist()}, directory)


def _name(kind: str, request: object) -> str:
    try:
        digest = hashlib.sha256(pickle.dumps((SCHEDULED_VERSION, request), protocol=5)).hexdigest()
    except (pickle.PicklingError, AttributeError, TypeError):
        return ""
    return f"{kind}-{digest}"


def _kept(
    name: str, solve: Callable[[], G], read: Callable[[Stored], G], written: Callable[[G], Stored], directory: Path | None
) -> G:  # fmt: skip
    """Return what the entry of a name holds; where there is none, or what cannot be read, solve and keep it."""
    directory = directory or cache_directory()
    if directory is None or not name:
        return solve()
    entry = directory / f"{name}.json"
    kept = read_entry(entry, read)
    if kept is not None:
        return kept
    found = solve()
    try:
        _keep(entry, json.dumps(written(found)))
    except OSError:
        pass
    return found


def read_entry(entry: Path, read: Callable[[Stored], G]) -> G | None:
    """Return what an entry holds; None where it cannot be read."""
    try:
        return read(read_json(entry))
    except (ValueError, KeyError, TypeError, OverflowError, np.linalg.LinAlgError, DesignError):
        return None


def _keep(entry: Path, text: str) -> None:
    """Put an entry in its place in one step, through no symbolic link, readable for its user alone."""
    entry.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    part = entry.with_suffix(f".{secrets.token_hex(6)}.part")
    try:
        with open(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600), "w") as file:
            file.write(text)
        part.replace(entry)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
