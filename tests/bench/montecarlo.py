"""10,000 runs of the Chapter 2 example: the batch engine beside a plain numpy loop and beside scipy's ODE solver.

All meet the same jumps and the same uncertainty, and must find the same settling times: the largest difference is in the
row. The slow ones do fewer runs; their time is per run, times 10,000. Their jumps are drawn before their clock starts.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from msgspec import structs
from numpy.typing import NDArray

from design.as_printed import CHAPTER2_START, chapter2_gain, chapter2_process, chapter2_system
from design.monte_carlo import Workers
from design.monte_carlo.jump_loop import JumpLoop
from design.monte_carlo.studies import CHUNK, mean_states, mjls_energies, settling_times
from design.networked_loop.closed_loop import loop_structure
from design.processes.rates import WeibullRate
from design.processes.semi_markov import SemiMarkov

FloatArray = NDArray[np.float64]
Stretch = tuple[float, float, FloatArray]

RUNS, DURATION_S, DT_S, SEED, BAND = 10_000, 10.0, 0.01, 0, 0.015
LOOP_RUNS, SOLVER_RUNS, REPEATS = 100, 20, 5


def chapter2_loop() -> JumpLoop:
    """The example with the gains (2.27), rates (2.26), and F of (2.25) with sigma, rho constant in U[-1, 1]."""
    return JumpLoop(
        system=chapter2_system("printed"),
        gain=chapter2_gain(),
        process=chapter2_process(),
        start=CHAPTER2_START,
        uncertain=True,
    )


def paths(loop: JumpLoop, runs: int) -> list[list[Stretch]]:
    """For the first runs: from when to when which matrix holds."""
    matrices = loop.matrices(seed=SEED, first=0, runs=CHUNK)
    out: list[list[Stretch]] = [[] for _ in range(runs)]
    for visit in loop.visits(DURATION_S, seed=SEED, first=0, runs=CHUNK):
        for k in np.flatnonzero(visit.run < runs):
            start, stop = float(visit.start_s[k]), float(visit.stop_s[k])
            edges = [*(start + loop.gain.starts_s[visit.mode[k]]).tolist(), np.inf]
            for section, (a, b) in enumerate(pairwise(edges)):
                if min(b, stop) > a:
                    which = loop.index(visit.mode[k : k + 1], section, visit.run[k : k + 1], CHUNK)
                    out[int(visit.run[k])].append((a, min(b, stop), matrices[:, :, int(which[0])]))
    return out


def settled(norms: FloatArray) -> float:
    """First grid time from which on a trajectory's norms stay in the band."""
    outside = np.flatnonzero(norms > BAND * norms[0])
    last = int(outside[-1]) if outside.size else -1
    return (last + 1) * DT_S if last + 1 < norms.size else np.inf


def numpy_loop(stretches: list[Stretch]) -> float:
    """One run, one grid step after the other, exact at the events: what one writes first."""
    from scipy.linalg import expm

    x, norms = np.array(CHAPTER2_START), np.empty(round(DURATION_S / DT_S) + 1)
    grid = 0
    for start, stop, m in stretches:
        phi, now = expm(m * DT_S), start
        while grid * DT_S < stop or (stop >= DURATION_S and grid < norms.size):
            step = grid * DT_S - now
            x = (phi if abs(step - DT_S) < 1e-12 else expm(m * step)) @ x
            now = grid * DT_S
            norms[grid] = np.sqrt(x @ x)
            grid += 1
        x = expm(m * (stop - now)) @ x
    return settled(norms)


def ode_solver(stretches: list[Stretch]) -> float:
    """One run by solve_ivp (RK45) from event to event, with the tolerance that settling times to 0.01 s need."""
    from scipy.integrate import solve_ivp

    times = np.arange(round(DURATION_S / DT_S) + 1) * DT_S
    x, norms = np.array(CHAPTER2_START), np.empty(times.size)
    for start, stop, m in stretches:
        here = (times >= start) & ((times < stop) | (stop >= DURATION_S))
        wanted = np.append(times[here & (times < stop)], stop)
        found = solve_ivp(partial(_slope, m), (start, stop), x, t_eval=wanted, rtol=1e-6, atol=1e-9).y
        norms[here] = np.sqrt((found * found).sum(axis=0))[: int(here.sum())]
        x = found[:, -1]
    return settled(norms)


def _slope(m: FloatArray, t: float, x: FloatArray) -> FloatArray:
    return np.asarray(m @ x)


def bench_montecarlo(progress: Callable[[str], None] = lambda text: None) -> list[dict[str, Any]]:
    """Measure everything in one run; every row has its time per 10,000 runs and its ratio to the engine on one core."""
    loop = chapter2_loop()
    cores = len(os.sched_getaffinity(0))
    rows: list[dict[str, Any]] = []

    def engine(loop: JumpLoop, workers: Workers) -> FloatArray:
        return settling_times(loop, RUNS, duration_s=DURATION_S, dt_s=DT_S, band=BAND, seed=SEED, workers=workers)

    def row(what: str, work: Callable[[], Any], *, runs: int = RUNS, repeats: int = 1) -> Any:
        progress(what)
        result, seconds = None, []
        for _ in range(repeats):
            begun = time.perf_counter()
            result = work()
            seconds.append(time.perf_counter() - begun)
        took = float(np.median(seconds)) * RUNS / runs
        ratio = took / rows[0]["s per 10,000"] if rows else 1.0
        rows.append({"what": what, "runs": runs, "s per 10,000": took, "ratio": ratio, "largest difference, s": ""})
        return result

    engine(loop, Workers())  # warm-up
    exact = row("engine, one core", lambda: engine(loop, Workers()), repeats=REPEATS)

    def compare(found: FloatArray) -> None:
        # Not-settled on both sides is no difference.
        both = exact[: found.size]
        with np.errstate(invalid="ignore"):
            gap = np.where(found == both, 0.0, np.abs(found - both))
        rows[-1]["largest difference, s"] = float(gap.max())

    for jobs in sorted({min(2, cores), cores} - {1}):
        workers = Workers(backend="loky", jobs=jobs)
        engine(loop, workers)  # starts the processes
        compare(row(f"engine, {jobs} cores", partial(engine, loop, workers), repeats=REPEATS))
    row(
        "engine, one core, every grid state: E x",
        lambda: mean_states(loop, RUNS, duration_s=DURATION_S, dt_s=DT_S, seed=SEED),
    )
    weibull = WeibullRate(scale_s=1.0, shape=2.0)
    newton = structs.replace(loop, process=SemiMarkov(rates=((None, weibull), (weibull, None))))
    row("engine, one core, Weibull(1, 2) rates", lambda: engine(newton, Workers()))
    slow = paths(loop, LOOP_RUNS)
    numpy_loop(slow[0])
    ode_solver(slow[0])
    compare(row("numpy loop over runs and steps", lambda: np.array([numpy_loop(p) for p in slow]), runs=LOOP_RUNS))
    few = slow[:SOLVER_RUNS]
    compare(row("scipy.integrate.solve_ivp, rtol 1e-6", lambda: np.array([ode_solver(p) for p in few]), runs=SOLVER_RUNS))
    row("discrete time: networked motor loop, 400 samples", motor_loop)
    return rows


def motor_loop() -> FloatArray:
    """10,000 runs of the motor of Chapter 7 under delays, as a jump-linear system in discrete time."""
    from scipy.linalg import expm

    block = np.zeros((3, 3))
    block[:2] = [[0.0, 1.0, 0.0], [0.0, -3.5287, 172.38]]
    phi = expm(block * 0.05)
    tau = [[0.6, 0.4, 0.0], [0.7, 0.2, 0.1], [0.8, 0.1, 0.1]]
    gains = np.array([[-0.1576, -0.1318], [-0.0878, 0.0091], [-0.0342, 0.0074]]).reshape(3, 2, 1, 1)
    loop = loop_structure(phi[:2, :2], phi[:2, 2:], [[1.0, 0.0]], tau, [[0.5, 0.5], [0.7, 0.3]], "generated")
    system = loop.system(gains)
    start = np.zeros(system.order)
    start[0] = 1.0
    return mjls_energies(system, RUNS, 400, start=start)
