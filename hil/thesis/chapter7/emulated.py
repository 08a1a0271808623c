"""Many runs of a loop of Section 7.4, packet by packet or on the rig: in their law the printed sums of squares are ranked.

Every split over cores gives the same numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from design.monte_carlo.parallel_runs import Workers, spread
from design.networked_loop.loop_parts import steady_state
from hil.measure.batch_protocols import BatchValues, BatchView
from hil.measure.prediction import predict
from hil.rig.loop import Loop
from hil.sweeps.lockstep import run_batch, runs_per_batch, view_of_batch
from hil.thesis.chapter import ReportProgress
from hil.thesis.chapter7.models import NETWORK, Array, Plant

SEED = 7
BATCH_RUNS = 200


def stationary(transition: Array) -> Array:
    """Stationary distribution of a row-stochastic matrix whose chain is ergodic."""
    return np.asarray(np.linalg.matrix_power(transition, 1024)[0])


def errors(
    plant: Plant, gains: Array, selection: str, reference: Array, *, disturbance: Array, runs: int, seed: int = SEED
) -> Array:
    """Tracking errors y - r of single-output loops.

    Args:
        plant: A, B, C with one output.
        gains: [tau][row][m][1].
        selection: ``generated`` (the printed rule) or ``constant``.
        reference: r(k), (K,).
        disturbance: input disturbance, (K, m).
        runs: how many.

    Returns:
        (K, runs); infinite from where a loop leaves all bounds.
    """
    rng = np.random.default_rng(seed)
    every, zero = np.arange(runs), np.zeros(runs, dtype=np.intp)
    sums = [np.cumsum(matrix, axis=1) for matrix in NETWORK]
    tau, d = (rng.choice(len(P), p=stationary(P), size=runs) for P in NETWORK)
    held = steady_state(*plant).input[:, 0]
    x = np.zeros((runs, plant.A.shape[0]))
    outputs: list[Array] = []
    packets: list[Array] = []
    made: list[npt.NDArray[np.intp]] = []
    found = np.empty((len(reference), runs))
    for k, r in enumerate(reference):
        if k:
            tau, d = (
                _next(rng.random(runs), total, mode) for total, mode in zip(sums, (tau, d), strict=True)
            )
        outputs = [x @ plant.C[0], *outputs[:2]]  # newest first, as are packets and the d at which they were made
        made = [d, *made[:1]]
        found[k] = outputs[0] - r
        seen = np.stack([outputs[min(age, len(outputs) - 1)] for age in range(3)])[tau, every] - r
        rows = held * r + gains[tau, :, :, 0] * seen[:, None, None]
        rows[tau > k] = 0.0  # no sample has come
        packets = [rows, *packets[:1]]
        sent = np.stack([packets[min(age, len(packets) - 1)] for age in range(2)])[d, every]
        row = np.where(d == 0, d, made[-1]) if selection == "generated" else zero
        u = sent[every, row]
        u[d > k] = 0.0  # no packet has come
        with np.errstate(over="ignore", invalid="ignore"):
            x = x @ plant.A.T + (u + disturbance[k]) @ plant.B.T
        x[~np.isfinite(x)] = np.inf
    return found


def _next(drawn: Array, total: Array, mode: npt.NDArray[np.intp]) -> npt.NDArray[np.intp]:
    """The mode whose share of [0, 1] the number drawn lies in; `total` has the summed rows of the matrix."""
    found = np.zeros(len(mode), dtype=np.intp)
    for column in total.T[:-1]:
        found += drawn > column[mode]
    return found


def sums_of_squares(error: Array, period_s: float, start: int = 0) -> Array:
    """T sum_{k >= start} |e(k)|^2 per run, (runs,); infinite where a run diverges.

    Sensor, controller and actuator exchange packets as in Figure 7.1; modes start stationary. ``design.networked_loop`` predicts
    mean and deviation exactly; the sums of squares are skewed, so a printed run is judged by its rank among the runs.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        total = period_s * (error[start:] ** 2).sum(axis=0)
    return np.asarray(np.where(np.isfinite(total), total, np.inf))


T = TypeVar("T")


def on_all_cores(
    work: Callable[..., T], asked: Sequence[Sequence[Any]], report_progress: ReportProgress, names: Sequence[str]
) -> list[T]:
    """``work(*arguments)`` for all of them, in their order; progress is reported as each ends. Give the longest first."""
    found: dict[int, T] = {}
    report_progress(f"{len(asked)} pieces", 0, len(asked))
    for at, result in spread(partial(_numbered, work), [*enumerate(asked)], Workers(backend="loky"), unordered=True):
        found[at] = result
        report_progress(names[at], len(found), len(asked))
    return [found[at] for at in range(len(asked))]


def _numbered(work: Callable[..., T], job: tuple[int, Sequence[Any]]) -> tuple[int, T]:
    at, arguments = job
    return at, work(*arguments)


Numbers = Callable[[BatchView], Sequence[BatchValues]]


def numbers_of(loop: Loop, seeds: Sequence[int], columns: int, numbers: Numbers) -> BatchValues:
    """Numbers of every run.

    They are runs of a loop on the rig with many seeds, all at once.

    Args:
        loop: a loop that can be run in lockstep; the numbers of a run are those that it has alone, bit for bit.
        seeds: one run each.
        columns: how many numbers a run has.
        numbers: gives them from a view of runs, (runs,) each.

    Returns:
        (seeds, columns); infinite in runs that safety stops or that leave all bounds.
    """
    found = np.full((len(seeds), columns), np.inf)
    size = runs_per_batch(loop)
    for at in range(0, len(seeds), size):
        together = run_batch(loop, seeds[at : at + size])
        if together.known.any():
            found[at : at + size][together.known] = np.stack(numbers(view_of_batch(loop, together)), axis=1)
    return found


def squared_error(loop: Loop) -> tuple[float, float]:
    """Return the mean squared error of runs, rad^2 s, and how many standard errors it is from its prediction."""
    e = loop.experiment
    runs = run_batch(loop, range(BATCH_RUNS))
    squares = (runs.outputs[0] - runs.reference[-1, 0])[:, runs.known] ** 2  # the error counts from t = 0, see Table 7.2
    sums = float(e.period) * squares.sum(axis=0)
    predicted = predict(loop, e.slots)
    expected = np.nan if predicted is None else predicted.sums[0].mean
    mean = float(sums.mean())
    return mean, abs(mean - expected) / (float(sums.std()) / np.sqrt(len(sums)))
