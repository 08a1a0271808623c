"""Run the controllers that were tried on the problem set, and store the best of each.

``python -m tests.hil.sweeps.problems.store``; with names of problems, only these; what is stored of the others stays.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from design.networked_loop.certify import lower_bounds
from hil.design_questions import tracking_target
from hil.errors import HilError
from hil.sweeps.problems import Problem, Reached, folder, problems, reached

RUNS = 1000


def lower_bound(problem: Problem) -> float | None:
    """Return what no controller that is linear in what it knows goes below in the mean, None where no bound is known.

    The pulse is an impulse of the discrete loop, met in a long run; the sum of squared errors after it, times the period, has no
    end. Only for one input and one sensor node: over two inputs the bound is of both impulses together.
    """
    try:
        target = tracking_target(problem.named)
    except HilError:
        return None
    if target.B.shape[1] != 1:
        return None
    initial = np.kron(target.sc.stationary, target.ca.stationary)
    bounds = lower_bounds(target.A, target.B, target.C, target.sc, target.ca, initial=initial)
    return float(target.period_s * problem.pulse**2 * bounds.h2_delayed_information**2)


def best_of(found: Sequence[Reached]) -> Reached | None:
    """Return the controller of the smallest mean, of those that ran and that no verdict refused."""
    ran = [each for each in found if each.mean is not None and each.verdict != "refused"]
    return min(ran, key=lambda each: each.mean or 0.0) if ran else None


def store(chosen: Sequence[Problem], path: Path, runs: int = RUNS) -> None:
    """Run what was tried on some problems, print it, and store the best.

    Args:
        chosen: the problems.
        path: of what is stored.
        runs: seeds of each controller, from 0.

    Raises:
        HilError: none of the controllers of a problem ran.
    """
    stored: dict[str, Any] = msgspec.json.decode(path.read_bytes()) if path.exists() else {}
    for problem in chosen:
        tried = [reached(problem, table, runs) for table in problem.tried]
        for each in tried:
            print(f"{problem.name}: {each.controller}: {each.mean} ({each.low} to {each.high}) {each.verdict} {each.said}")
        best = best_of(tried)
        if best is None:
            raise HilError(f"{problem.name}: none of the controllers that are named ran")
        stored[problem.name] = {**msgspec.to_builtins(best), "lower_bound": lower_bound(problem)}
    path.write_text(json.dumps(dict(sorted(stored.items())), indent=1) + "\n")


if __name__ == "__main__":
    store([problem for problem in problems() if problem.name in (sys.argv[1:] or [problem.name])], folder() / "best.json")
