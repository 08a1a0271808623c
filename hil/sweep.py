"""Many seeds of one experiment on all cores: same loop, same code, no log files."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.experiment import Experiment
from hil.runtime.loop import Loop, compose

METRICS = ("sse", "sse_after_5s", "overshoot", "settling_time_s", "steady_state_error", "max_abs_u")
TOPICS = ("/plant/measurement", "/reference", "/actuator/applied", "/events")


def run_seeds(loop: Loop, seeds: Sequence[int]) -> list[dict[str, float]]:
    """Run a loop for some seeds in this process; return one row of metrics per seed (NaN where undefined)."""
    from hil.report.metrics import run_metrics
    from hil.session import simulate

    rows = []
    for seed in seeds:
        run = simulate(loop, seed, TOPICS)
        found = run_metrics(run, loop.experiment)
        row = {name: float("nan") if found[name] is None else float(found[name]) for name in METRICS}
        row["seed"] = seed
        row["stopped"] = float(any(e["kind"] == "safety" for e in run.events))
        rows.append(row)
    return rows


def sweep(
    experiment: Experiment,
    seeds: Sequence[int],
    *,
    jobs: int = -1,
    progress: Callable[[int], None] = lambda done: None,
) -> dict[str, NDArray[np.float64]]:
    """Run an experiment for every seed.

    Every run has its own seed, so the numbers are the same for every number of jobs and every split.

    Parameters
    ----------
    experiment : Experiment
        What to run, in virtual time.
    seeds : sequence of int
        One run each.
    jobs : int
        Processes; -1 for one per core.
    progress : callable
        Told how many runs have been done.

    Returns
    -------
    dict of str to ndarray
        ``seed``, ``stopped`` and every metric, one entry per run in the order of the seeds. After Ctrl-C: what was done.
    """
    from joblib import Parallel, delayed

    loop = compose(experiment)
    workers = min(jobs if jobs > 0 else len(os.sched_getaffinity(0)), max(len(seeds), 1))
    size = max(1, min(25, -(-len(seeds) // (4 * workers))))
    chunks = [seeds[i : i + size] for i in range(0, len(seeds), size)]
    rows: list[dict[str, float]] = []
    try:
        parallel = Parallel(n_jobs=workers, return_as="generator", inner_max_num_threads=1, backend="loky")
        for part in parallel(delayed(run_seeds)(loop, chunk) for chunk in chunks):
            rows += part
            progress(len(rows))
    except KeyboardInterrupt:
        pass  # what is done is worth having
    return {name: np.array([row[name] for row in rows]) for name in ("seed", "stopped", *METRICS)}


def statistics(values: NDArray[np.float64]) -> dict[str, Any]:
    """Return mean, standard deviation, standard error and percentiles of one metric over the runs that have it."""
    finite = values[np.isfinite(values)]
    if not finite.size:
        return {"n": 0, "mean": None, "sd": None, "se": None, "percentiles": {}}
    sd = float(finite.std(ddof=1)) if finite.size > 1 else 0.0
    points = (1, 5, 25, 50, 75, 95, 99)
    return {
        "n": int(finite.size),
        "mean": float(finite.mean()),
        "sd": sd,
        "se": sd / float(np.sqrt(finite.size)),
        "percentiles": {str(p): float(v) for p, v in zip(points, np.percentile(finite, points))},
    }
