"""Figures of many runs: a sweep in lockstep, 100,000 runs, over dask, and the report that takes 100."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Iterator
from functools import cache, partial
from pathlib import Path
from typing import Any

from design.monte_carlo import safe_path
from hil.errors import HilError
from tests.bench.engines import SWEEPS, bench_sweep
from tests.bench.figure import FLAT, AtMost, Figure, Found, Measure, Part, Tell
from tests.bench.processes import HIL, Spent, spent

MOTOR = "dc-motor-hinf"
ALONE = "run by run"
TOGETHER = AtMost(ratio=1 / 50)


def _of_sweep(name: str) -> str:
    return f"{name} in a sweep, CPU time per run"


THOUSAND = Figure(name="hil sweep, 1000 runs, wall time", unit="s", peer="run by run on as many cores", goal=AtMost(ratio=0.1))
MANY = Figure(name="hil sweep, 100,000 runs, wall time", unit="s", peer="run by run on as many cores", goal=AtMost(ratio=0.04))
MANY_MB = Figure(name="hil sweep, 100,000 runs, peak memory", unit="MB", peer="10,000 runs", condition=FLAT)
DASK = Figure(name="sweep over dask, wall time per run", unit="us", peer="processes of this machine, as many")
REPORT = Figure(name="hil report of a run, wall time", unit="s", peer="its 100 runs, run by run", goal=AtMost(ratio=0.5))


def _sweeps(tell: Tell, quick: bool) -> Iterator[Found]:
    for row in bench_sweep(tell, runs=20 if quick else 1000, alone=1 if quick else 8):
        note = f"{row['slots']} slots a run"
        yield Found(_of_sweep(row["sweep"]), row["lockstep us per run"], row["run by run us"], note)


@cache
def _alone_s(quick: bool) -> float:
    """Seconds of one run of the motor, run by run."""
    from hil.compose import compose
    from hil.experiment import load_experiment
    from hil.sweeps.seeds import run_one_by_one

    loop, runs = compose(load_experiment(MOTOR), certify=False), 1 if quick else 8
    begun = time.perf_counter()
    run_one_by_one(loop, range(runs))
    return (time.perf_counter() - begun) / runs


def _sweep(runs: int) -> Spent:
    return spent([*HIL, "sweep", MOTOR, "--runs", str(runs), "--json"])


def _commands(tell: Tell, quick: bool) -> Iterator[Found]:
    cores, reported = len(os.sched_getaffinity(0)), "peer projected from 8 runs"
    few, some, many = (20, 20, 20) if quick else (1000, 10_000, 100_000)
    tell(f"hil sweep --runs {few}")
    first = _sweep(few)
    yield Found(THOUSAND.name, first.wall_s, _alone_s(quick) * few / cores, reported)
    tell(f"hil sweep --runs {some}, then {many}")
    ten_times_fewer = first if quick else _sweep(some)
    last = first if quick else _sweep(many)
    yield Found(MANY.name, last.wall_s, _alone_s(quick) * many / cores, reported)
    yield Found(MANY_MB.name, last.peak_mb, ten_times_fewer.peak_mb, "the largest of its processes")


def _dask(tell: Tell, quick: bool) -> Iterator[Found]:
    from design.monte_carlo import Workers
    from hil.experiment import load_experiment
    from hil.sweeps.seeds import here, run_sweep

    try:
        from distributed import LocalCluster
    except ImportError:
        raise HilError("dask[distributed] is not installed") from None
    cores = len(os.sched_getaffinity(0))
    warm, runs = (1, 2) if quick else (4000, 10_000)
    experiment = load_experiment(MOTOR)

    def wall_us(workers: Any) -> float:
        run_sweep(experiment, range(warm), workers=workers)
        begun = time.perf_counter()
        run_sweep(experiment, range(runs), workers=workers)
        return (time.perf_counter() - begun) / runs * 1e6

    tell(f"{runs} runs over {cores} workers of dask, and over {cores} processes")
    cluster = partial(LocalCluster, n_workers=cores, threads_per_worker=1, dashboard_address=None, processes=not quick)
    with safe_path(), cluster() as started:
        ours = wall_us(Workers(backend="dask", scheduler=started.scheduler_address))
    yield Found(DASK.name, ours, wall_us(here(-1)), f"{runs} runs, {cores} workers each, started before")


def _report(tell: Tell, quick: bool) -> Iterator[Found]:
    tell("hil report of a run")
    with tempfile.TemporaryDirectory(prefix="hilrig-bench-") as folder:
        log = str(Path(folder) / "run.mcap")
        spent([*HIL, "run", MOTOR, "-o", log, "--quiet", *(["--duration", "1 s"] if quick else [])])
        ours = spent([*HIL, "report", log])
    yield Found(REPORT.name, ours.wall_s, _alone_s(quick) * 100, "1000 slots; peer projected from 8 runs")


PART = Part("sweeps", "many runs: in lockstep, 100,000 of them, over dask, in a report", 90.0, (
    Measure(
        tuple(Figure(name=_of_sweep(name), unit="us", peer=ALONE, condition=TOGETHER) for name in SWEEPS), _sweeps, loops=True
    ),
    Measure((THOUSAND, MANY, MANY_MB), _commands, loops=True),
    Measure((DASK,), _dask),
    Measure((REPORT,), _report, loops=True),
))  # fmt: skip
