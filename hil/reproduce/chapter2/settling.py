"""Settling times (2.28): their means and deviations, Table 2.1, and one run of both controllers (Figures 2.2 to 2.4)."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from design.as_printed.examples import (
    CHAPTER2_START,
    chapter2_gain,
    chapter2_process,
    chapter2_reference_gain,
    chapter2_system,
)
from design.controllers.scheduled_gain import ScheduledGain
from design.monte_carlo.jump_loop import JumpLoop
from design.monte_carlo.studies import settling_times
from design.processes.rates import WeibullRate
from design.processes.semi_markov import SemiMarkov
from hil.reproduce.chapter import Part, ReportProgress
from hil.reproduce.chapter2.figures import Settling, convergence, monte_carlo_average, one_run
from hil.reproduce.judgement import TAIL, Row, above, rank, row, standard_errors, within_error

FloatArray = npt.NDArray[np.float64]

RUNS = 10_000
SEED = 1
BASIS = "rate 2h, F of (2.25), sigma and rho constant per run and uniform in [-1, 1], 10,000 runs"
TABLE_2_1 = (0.87, 1.75, 3.03)
SHARES = (0.6827, 0.9545, 0.9973)
"""Shares of a normal law within 1, 2, 3 standard deviations."""


def weibull_process() -> SemiMarkov:
    """The process of the published Monte Carlo runs: Weibull of scale 1 and shape 2, whose hazard is 2h."""
    rate = WeibullRate(scale_s=1.0, shape=2.0)
    return SemiMarkov(rates=((None, rate), (rate, None)))


def loop_of(gain: ScheduledGain, mode: int = 0, process: SemiMarkov | None = None) -> JumpLoop:
    """The example with these gains, from its printed initial state."""
    return JumpLoop(
        system=chapter2_system("printed"), gain=gain, process=process or weibull_process(), start=CHAPTER2_START, mode=mode,
        uncertain=True,
    )  # fmt: skip


def settling(report_progress: ReportProgress) -> Part:
    """Every number and figure of the Monte Carlo study of Section 2.5."""
    ours, other = chapter2_gain(), chapter2_reference_gain()
    asked = {
        "(2.27)": (loop_of(ours), 20.0),
        "[1, 2]": (loop_of(other), 40.0),
        "(2.27) from mode 2": (loop_of(ours, mode=1), 20.0),
        "(2.27), printed rate (2.26)": (loop_of(ours, process=chapter2_process()), 20.0),
        "(2.27), h_1 moved to 0.2 s": (loop_of(chapter2_gain(0.2)), 20.0),
        "[1, 2], printed rate (2.26)": (loop_of(other, process=chapter2_process()), 40.0),
    }
    times: dict[str, FloatArray] = {}
    for name, (loop, duration_s) in asked.items():
        report_progress(f"{RUNS} runs, {name}", len(times), len(asked) + 1)
        times[name] = settling_times(loop, RUNS, duration_s=duration_s, seed=SEED)
    report_progress("figures", len(asked), len(asked) + 1)
    settled = Settling(published=times["(2.27)"], reference=times["[1, 2]"], published_from_mode_2=times["(2.27) from mode 2"])
    figures = (
        one_run(loop_of(ours), loop_of(other)),
        monte_carlo_average(loop_of(ours), loop_of(other), settled, RUNS, SEED),
        convergence(settled),
    )
    return Part(rows=(*moment_rows(times), *single_run_rows(times), *table_rows(times)), figures=figures)


def moment_rows(times: dict[str, FloatArray]) -> list[Row]:
    """Means and deviations of the settling time, printed and computed, both of 10,000 runs."""
    rows = []
    for name, mean, deviation in (("(2.27)", 3.5741, 0.8849), ("[1, 2]", 9.9100, 2.1895)):
        found = times[name]
        rows.append(
            row(
                f"settling time (2.28) of {name}, mean and deviation", f"{mean:.4f} s, {deviation:.4f} s",
                standard_errors("mean (s)", found.mean(), mean, sd=float(found.std()), runs=RUNS, printed_runs=RUNS),
                within_error(
                    "deviation (s)", found.std(), deviation, error=deviation_error(found) * math.sqrt(2.0),
                    why="4 standard errors of the deviation of 10000 runs and of 10000 printed ones",
                ),
                basis=f"{BASIS}; " + ", ".join(
                    f"{k}: {v.mean():.2f} s, {v.std():.2f} s" for k, v in times.items() if k.startswith(name) and k != name
                ),
            )
        )  # fmt: skip
    return rows


def deviation_error(values: FloatArray) -> float:
    """Standard error of the standard deviation: sqrt((m4 - s^4) / (4 n s^2)), any law with a fourth moment."""
    spread = float(values.std())
    fourth = float(np.mean((values - values.mean()) ** 4))
    return math.sqrt((fourth - spread**4) / (4.0 * values.size)) / spread


def single_run_rows(times: dict[str, FloatArray]) -> list[Row]:
    """The run of Figure 2.2a among ours."""
    ours, other = times["(2.27)"], times["[1, 2]"]
    return [
        row(
            "Figure 2.2a: one run with (2.27) converges in 2.95 s", "2.95 s",
            rank(f"share of {RUNS} runs below 2.95 s", ours, 2.95),
            computed=f"median {np.median(ours):.2f} s, 99 % of the runs in [{np.quantile(ours, 0.005):.2f}, "
            f"{np.quantile(ours, 0.995):.2f}] s",
            basis=f"converged as in (2.28); {BASIS}",
        ),
        row(
            "Figure 2.2a: the same run with [1, 2] takes more than 10 s", "> 10 s",
            above(f"share of {RUNS} runs that take more than 10 s", float(np.mean(other > 10.0)), TAIL),
            basis=f"one run in {1 / TAIL:.0f} would do; {BASIS}",
        ),
        row(
            "(2.27) settles faster than [1, 2]", "3.5741 s < 9.9100 s",
            above(
                "mean difference less 4 standard errors (s)",
                float((other - ours).mean()) - 4.0 * float((other - ours).std()) / math.sqrt(RUNS), 0.0,
            ),
            basis=BASIS,
        ),
    ]  # fmt: skip


def table_rows(times: dict[str, FloatArray]) -> list[Row]:
    """Table 2.1 read as quantiles of |T_s - mean|: from the printed initial mode, and from the other one."""
    rows = []
    for start, name in (("r_0 = 1, as printed", "(2.27)"), ("r_0 = 2, not as printed", "(2.27) from mode 2")):
        found = times[name]
        values = np.quantile(np.abs(found - found.mean()), SHARES)
        errors = quantile_errors(found)
        for k, printed in enumerate(TABLE_2_1):
            rows.append(
                row(
                    f"Table 2.1, +-{k + 1} standard deviation, {start}", f"{printed} s",
                    within_error(
                        "quantile (s)", values[k], printed, error=float(errors[k]) * math.sqrt(2.0),
                        why="4 bootstrap errors of the quantile, 10000 runs and 10000 printed ones",
                    ),
                    computed=f"{values[k]:.2f} s ({errors[k]:.2f})",
                    basis=f"read as the {SHARES[k]:.2%} quantile of |T_s - mean|: the table is no multiple of 0.8849 s; {BASIS}",
                )
            )  # fmt: skip
    return rows


def quantile_errors(values: FloatArray, resamples: int = 200) -> FloatArray:
    """Bootstrap standard errors of the quantiles of |T_s - mean|."""
    rng = np.random.default_rng(0)
    drawn = values[rng.integers(0, values.size, (resamples, values.size))]
    away = np.abs(drawn - drawn.mean(axis=1, keepdims=True))
    return np.asarray(np.quantile(away, SHARES, axis=1).std(axis=1))
