"""Paths of semi-Markov processes for a whole batch of runs at once: one event of every run per step.

A *visit* is a time interval in which no process jumps. Batches of visits come in order: the k-th batch holds the k-th
visit of every run that is not at its end yet, sampled exactly from one draw of Exp(1) and one of U(0, 1) per jump.

References: thesis Section 2.2 (one process), Section 4.2 (failure and detection); design.processes.semi_markov for the sampling.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from design.monte_carlo.random_streams import JUMPS, DrawTable
from design.processes.elementary import log
from design.processes.semi_markov import FaultDetection, SemiMarkov

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.intp]

PAGE = 16
"""Counter values per page of jump draws: 32 jumps of one process."""


class Visits(NamedTuple):
    """One visit of each of some runs: arrays of shape (runs still going,).

    ``run`` counts within the batch; ``mode`` is the plant's, ``seen`` the mode that the gain is scheduled by, ``age_s``
    the reading of the gain's clock at ``start_s``.
    """

    run: IntArray
    mode: IntArray
    seen: IntArray
    age_s: FloatArray
    start_s: FloatArray
    stop_s: FloatArray


def semi_markov_visits(
    process: SemiMarkov, mode: int, duration_s: float, *, seed: int, first: int, runs: int
) -> Iterator[Visits]:
    """Visits up to ``duration_s`` of the runs first, ..., first + runs - 1, all starting in ``mode`` with clock 0."""
    draws = DrawTable(seed, first, runs, purpose=JUMPS, blocks=PAGE)
    run, modes, now = np.arange(runs), np.full(runs, mode, dtype=np.intp), np.zeros(runs)
    jump = 0
    while run.size:
        exponential, uniform = -log(draws.row(2 * jump)), draws.row(2 * jump + 1)
        h, target = process.jump(modes, 0.0, exponential[run], uniform[run])
        then = now + h
        yield Visits(run, modes, modes, np.zeros(run.size), now, np.minimum(then, duration_s))
        going = then < duration_s
        run, modes, now = run[going], target[going], then[going]
        jump += 1


def fault_detection_visits(
    process: FaultDetection,
    failure: int,
    detection: int,
    duration_s: float,
    *,
    seed: int,
    first: int,
    runs: int,
    sees_failure: bool = False,
) -> Iterator[Visits]:
    """Visits of the pair (eta, r): the plant follows eta, the gain follows r and its clock (or both modes).

    At every event both next jumps are drawn anew given the clocks' readings, which leaves the law as it is:
    H(h) - H(a) is Exp(1) given h > a, whatever went before. The earlier one happens.
    """
    draws = DrawTable(seed, first, runs, purpose=JUMPS, blocks=PAGE)
    kinds = process.detection[0].modes
    run, now = np.arange(runs), np.zeros(runs)
    eta, r = np.full(runs, failure, dtype=np.intp), np.full(runs, detection, dtype=np.intp)
    eta_age, r_age = np.zeros(runs), np.zeros(runs)
    event = 0
    while run.size:
        rows = [draws.row(4 * event + k)[run] for k in range(4)]
        eta_h, eta_next = process.failure.jump(eta, eta_age, -log(rows[0]), rows[1])
        r_h, r_next = np.empty(run.size), np.empty(run.size, dtype=np.intp)
        for i, law in enumerate(process.detection):
            here = np.flatnonzero(eta == i)
            r_h[here], r_next[here] = law.jump(r[here], r_age[here], -log(rows[2][here]), rows[3][here])
        # Rounding must not let an event fall before now; with no jump left both are inf.
        to_eta, to_r = np.maximum(eta_h - eta_age, 0.0), np.maximum(r_h - r_age, 0.0)
        step = np.minimum(to_eta, to_r)
        then = now + step
        yield Visits(run, eta, eta * kinds + r if sees_failure else r, r_age, now, np.minimum(then, duration_s))
        going = then < duration_s
        fails = (to_eta <= to_r)[going]
        run, now = run[going], then[going]
        eta_age = np.where(fails, 0.0, (eta_age + step)[going])
        restart = ~fails | process.failure_restarts_detection_clock
        r_age = np.where(restart, 0.0, (r_age + step)[going])
        eta, r = np.where(fails, eta_next[going], eta[going]), np.where(fails, r[going], r_next[going])
        event += 1
