"""Runs of the example: Figures 2.2 to 2.4, Table 2.1, settling times (2.28), and both controllers in the emulated loop.

The loop is emulated by shipped experiments, sampled, packet by packet, with the same seeds.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from design.as_printed import CHAPTER2_START, chapter2_gain, chapter2_process, chapter2_reference_gain, chapter2_system
from design.controllers.scheduled_gain import ScheduledGain
from design.monte_carlo.jump_loop import JumpLoop
from design.monte_carlo.studies import mean_states, settling_times, trajectories
from design.processes.rates import WeibullRate
from design.processes.semi_markov import SemiMarkov
from hil.compose import compose
from hil.experiment import load_experiment
from hil.measure.view import view_of
from hil.pages import Figure, Histogram, Series
from hil.runtime.virtual import simulate
from hil.thesis import Array, Plot, ReportProgress
from hil.thesis.judgement import TAIL
from hil.thesis.statements import above, below, mean, run, statement

DT_S = 0.01


def _beside(title: str, y_label: str, t: Array, ours: Array, other: Array) -> Figure:
    """Return (2.27) beside [1, 2] over time."""
    curves = (Series(label="(2.27)", x=t, y=ours), Series(label="[1, 2]", x=t, y=other, style="dashed"))
    return Figure(title=title, y_label=y_label, series=curves)


def one_run(published: JumpLoop, reference: JumpLoop) -> Plot:
    """Figure 2.2: one run under the same switching, and 20 runs of (2.27)."""
    first = trajectories(published, 1, duration_s=10.0, dt_s=DT_S, seed=3)[0]
    other = trajectories(reference, 1, duration_s=10.0, dt_s=DT_S, seed=3)[0]
    many = trajectories(published, 20, duration_s=10.0, dt_s=DT_S, seed=3)
    t: Array = np.asarray(np.arange(first.shape[0]) * DT_S)
    panels = [_beside(f"2.2a: x{n + 1}(t), same switching instants", f"x{n + 1}", t, first[:, n], other[:, n]) for n in (0, 1)]
    for n in (0, 1):
        runs = tuple(Series(label="single runs", x=t, y=many[k, :, n], colour=0, faint=True) for k in range(20))
        panels.append(Figure(title=f"2.2b: x{n + 1}(t), 20 runs of (2.27)", y_label=f"x{n + 1}", series=runs))
    return Plot(title="Figure 2.2", panels=tuple(panels), intro="One run of both controllers, and 20 semi-Markov paths.")


def monte_carlo_average(ours: Array, other: Array, settled: dict[str, Array]) -> Plot:
    """Figure 2.3: average states, and the distribution of the settling times (2.28), s, of both gains by their names."""
    t: Array = np.asarray(np.arange(len(ours)) * DT_S)
    panels: list[Figure | Histogram] = [
        _beside(f"2.3a: mean of x{n + 1}, {RUNS} runs", f"E x{n + 1}", t, ours[:, n], other[:, n]) for n in (0, 1)
    ]
    for name, values in settled.items():
        counts, edges = np.histogram(values[np.isfinite(values)], bins=60)
        panels.append(
            Histogram(title=f"2.3b: settling time of {name}", edges=edges, counts=counts, x_label="settling time", x_unit="s")
        )
    return Plot(title="Figure 2.3", panels=tuple(panels))


def convergence(settled: dict[str, Array]) -> Plot:
    """Figure 2.4: mean and deviation of the settling times, s, against the number of runs."""
    panels = []
    for title, kind in (("2.4a: mean", "mean"), ("2.4b: standard deviation", "std")):
        series = []
        for name, values in settled.items():
            count = np.arange(1, values.size + 1, dtype=float)
            mean = np.cumsum(values) / count
            spread = np.sqrt(np.maximum(np.cumsum(values**2) / count - mean**2, 0.0))
            series.append(Series(label=name, x=count[9:], y=(mean if kind == "mean" else spread)[9:]))
        panels.append(
            Figure(
                title=f"{title} of the settling time", series=tuple(series), x_label="runs", x_unit="", x_log=True, y_label=kind,
                y_unit="s", sync=None,
            )
        )  # fmt: skip
    return Plot(title="Figure 2.4", panels=tuple(panels))


RUNS = 10_000
SEED = 1
BASIS = "rate 2h, F of (2.25), sigma and rho constant per run and uniform in [-1, 1], 10,000 runs"
TABLE_2_1 = ("0.87", "1.75", "3.03")
PRINTED = {"ours": ("(2.27)", "3.5741", "0.8849"), "other": ("[1, 2]", "9.9100", "2.1895")}
RUN_S = 2.95
"""In which one run with (2.27) converges."""
SHARES = (0.6827, 0.9545, 0.9973)
"""Shares of a normal law within 1, 2, 3 standard deviations."""
SAMPLES = f"{RUNS} runs and {RUNS} printed ones"
BOOTSTRAP = f"bootstrap, {SAMPLES}"


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


def settling(report_progress: ReportProgress) -> dict[str, Any]:
    """Every number and figure of the Monte Carlo study of Section 2.5."""
    ours, other = chapter2_gain(), chapter2_reference_gain()
    asked = {
        "ours": (loop_of(ours), 20.0),
        "other": (loop_of(other), 40.0),
        "ours from mode 2": (loop_of(ours, mode=1), 20.0),
        "ours, printed rate (2.26)": (loop_of(ours, process=chapter2_process()), 20.0),
        "ours, h_1 moved to 0.2 s": (loop_of(chapter2_gain(0.2)), 20.0),
        "other, printed rate (2.26)": (loop_of(other, process=chapter2_process()), 40.0),
    }
    times: dict[str, Array] = {}
    for name, (loop, duration_s) in asked.items():
        report_progress(f"{RUNS} runs, {name}", len(times), len(asked) + 1)
        times[name] = settling_times(loop, RUNS, duration_s=duration_s, seed=SEED)
    report_progress("figures", len(asked), len(asked) + 1)
    settled = {label: times[name] for name, (label, *_) in PRINTED.items()}
    means = [mean_states(loop_of(gain), RUNS, duration_s=10.0, dt_s=DT_S, seed=SEED) for gain in (ours, other)]
    past = [(-np.sign(CHAPTER2_START) * mean).max(axis=0) for mean in means]
    figures = one_run(loop_of(ours), loop_of(other)), monte_carlo_average(means[0], means[1], settled), convergence(settled)
    return times_in_numbers(times) | {
        "overshoot": past[0] / past[1], "past": past, "least": [mean.min(axis=0) for mean in means], "figures": figures,
    }  # fmt: skip


def times_in_numbers(times: dict[str, Array]) -> dict[str, Any]:
    """Moments, quantiles and standard errors of the settling times; an error counts the 10,000 printed runs too."""
    ours, other = times["ours"], times["other"]
    both = math.sqrt(2.0)
    away = {name: np.quantile(np.abs(times[name] - times[name].mean()), SHARES) for name in ("ours", "ours from mode 2")}
    ahead = other - ours
    return {
        "times": times, "mean": {name: found.mean() for name, found in times.items()},
        "sd": {name: found.std() for name, found in times.items()},
        "mean_error": {name: found.std() * math.sqrt(2.0 / found.size) for name, found in times.items()},
        "sd_error": {name: deviation_error(found) * both for name, found in times.items()},
        "others": {
            name: ", ".join(
                f"{k.replace(name, label)}: {v.mean():.2f} s, {v.std():.2f} s"
                for k, v in times.items() if k.startswith(name) and k != name
            )
            for name, (label, *_) in PRINTED.items()
        },
        "away": away, "away_error": {name: quantile_errors(times[name]) for name in away},
        "both": {name: both * quantile_errors(times[name]) for name in away}, "median": np.median(ours),
        "low": np.quantile(ours, 0.005), "high": np.quantile(ours, 0.995), "late": float(np.mean(other[ours <= RUN_S] > 10.0)),
        "ahead": float(ahead.mean()) - 4.0 * float(ahead.std()) / math.sqrt(ahead.size),
    }  # fmt: skip


def deviation_error(values: Array) -> float:
    """Standard error of the standard deviation: sqrt((m4 - s^4) / (4 n s^2)), any law with a fourth moment."""
    spread = float(values.std())
    fourth = float(np.mean((values - values.mean()) ** 4))
    return math.sqrt((fourth - spread**4) / (4.0 * values.size)) / spread


def quantile_errors(values: Array) -> Array:
    """Bootstrap standard errors of the quantiles of |T_s - mean|."""
    rng = np.random.default_rng(0)
    drawn = values[rng.integers(0, values.size, (200, values.size))]
    away = np.abs(drawn - drawn.mean(axis=1, keepdims=True))
    return np.asarray(np.quantile(away, SHARES, axis=1).std(axis=1))


FROM = "ours from mode 2"


# fmt: off
SETTLING = (
    *(
        statement(
            f"settling time (2.28) of {label}, mean and deviation", f"{middle} s, {deviation} s",
            mean("mean (s)", f"mean[{name}]", middle, error=f"mean_error[{name}]", why=SAMPLES),
            mean("deviation (s)", f"sd[{name}]", deviation, error=f"sd_error[{name}]", why=SAMPLES),
            basis=f"{BASIS}; {{others[{name}]}}",
        )
        for name, (label, middle, deviation) in PRINTED.items()
    ),
    statement(
        "Figure 2.2a: one run with (2.27) converges in 2.95 s", "2.95 s",
        run(f"share of {RUNS} runs below {RUN_S} s", "times[ours]", f"{RUN_S}"),
        computed="median {median:.2f} s, 99 % of the runs in [{low:.2f}, {high:.2f}] s", basis=f"converged as in (2.28); {BASIS}",
    ),
    statement(
        "Figure 2.2a: the same run with [1, 2] takes more than 10 s", "> 10 s",
        above(f"share that takes more than 10 s, of the runs that (2.27) ends by {RUN_S} s", "late", TAIL),
        basis=f"one run in {1 / TAIL:.0f} would do; {BASIS}",
    ),
    statement(
        "(2.27) settles faster than [1, 2]", "faster", above("mean difference less 4 standard errors (s)", "ahead", 0),
        basis=BASIS,
    ),
    statement(
        "Figure 2.3a: the average states converge with less overshoot than with [1, 2]", "less overshoot",
        *(below(f"overshoot of E x{n + 1} past 0, (2.27) over [1, 2]", f"overshoot[{n}]", 1) for n in (0, 1)),
        witness=(above("overshoot of E x1 past 0, (2.27) over [1, 2]", "overshoot[0]", 1),),
        computed="E x1 falls from 5 to {least[0][0]:.2f} and {least[1][0]:.2f}; E x2 rises from -4 to {past[0][1]:.2f} and "
        "{past[1][1]:.2f}",
        basis=f"before E x2 rises it falls to {{least[0][1]:.2f}} and {{least[1][1]:.2f}}; {BASIS}",
    ),
    *(
        statement(
            f"Table 2.1, +-{k + 1} standard deviation, r_0 = 1", f"{printed} s",
            mean("quantile (s)", f"away[ours][{k}]", printed, error=f"both[ours][{k}]", why=BOOTSTRAP),
            beside=(mean("quantile from r_0 = 2 (s)", f"away[{FROM}][{k}]", printed, error=f"both[{FROM}][{k}]", why=BOOTSTRAP),),
            computed=f"{{away[ours][{k}]:.2f}} s ({{away_error[ours][{k}]:.2f}})",
            basis=f"read as the {SHARES[k]:.2%} quantile of |T_s - mean|: the table is no multiple of 0.8849 s; from r_0 = 2, "
            f"which is not as printed, {{away[{FROM}][{k}]:.2f}} s ({{away_error[{FROM}][{k}]:.2f}}); {BASIS}",
        )
        for k, printed in enumerate(TABLE_2_1)
    ),
)
# fmt: on

CONTROLLERS: Final = {"published": "smjls-robust-published", "reference": "smjls-robust-reference", "ours": "smjls-robust"}
"""(2.27), the gains of [1, 2], and ours."""

DURATION_S = 15.0
RIG_RUNS = 40
BAND = 0.015
"""Of |x(0)|, (2.28)."""


def settled_on_the_rig(name: str, seeds: Sequence[int]) -> Array:
    """Return the settling times (2.28) of runs of a shipped experiment, s, (runs,).

    Args:
        name: of the experiment.
        seeds: one run each; modes and uncertainty of a run come from its seed, not from the gains. A run that has not settled
            counts as `DURATION_S`, infinite if safety stops it.
    """
    experiment = load_experiment(name, [f"duration={DURATION_S}", "allow_uncertified=true"])
    loop = compose(experiment, certify=False)
    found = []
    for seed in seeds:
        time_s, states, _ = view_of(simulate(loop, seed), experiment, loop.rig).tracking()
        found.append(settling_time(time_s, states) if len(time_s) == experiment.slots else math.inf)
    return np.array(found)


def settling_time(time_s: Array, states: Array) -> float:
    """Return the first sample from which on |x| <= 0.015 |x(0)|, or the time after the last sample.

    Args:
        time_s: of the samples, s, (n,), equally spaced.
        states: (n, states).
    """
    size = np.linalg.norm(states, axis=1)
    outside = np.flatnonzero(size > BAND * size[0])
    last = int(outside[-1]) if outside.size else -1
    return float(time_s[0] + (last + 1) * (time_s[1] - time_s[0]))


def in_the_loop(report_progress: ReportProgress) -> dict[str, Any]:
    """Settling times of the three controllers, and how far apart they are, run by run."""
    times = {}
    for n, (who, name) in enumerate(CONTROLLERS.items()):
        report_progress(f"{RIG_RUNS} runs of {name}", n, len(CONTROLLERS))
        times[who] = settled_on_the_rig(name, range(RIG_RUNS))
    return comparison(times)


def comparison(times: dict[str, Array]) -> dict[str, Any]:
    """Return means, the share within 10 s, and what each is ahead of [1, 2], less four standard errors of the difference."""
    ahead = {who: times["reference"] - found for who, found in times.items() if who != "reference"}
    return {
        "mean": {who: found.mean() for who, found in times.items()},
        "late": {who: float((found > 10.0).mean()) for who, found in times.items()},
        "ahead": {who: d.mean() - 4.0 * d.std(ddof=1) / math.sqrt(d.size) for who, d in ahead.items()},
    }  # fmt: skip


RIG_BASIS = (
    f"{RIG_RUNS} runs of the shipped experiments, each of {DURATION_S:g} s at T = 5 ms, the same modes and uncertainty for all; "
    f"the rate h (2.26); a run that has not settled counts as {DURATION_S:g} s"
)
IN_THE_LOOP = (
    statement(
        "in the emulated loop (2.27) settles faster than [1, 2]", "faster",
        above("mean difference less 4 standard errors (s)", "ahead[published]", 0),
        computed="means {mean[published]:.2f} s and {mean[reference]:.2f} s; {late[published]:.0%} and {late[reference]:.0%} of "
        "the runs take more than 10 s",
        basis=RIG_BASIS,
    ),
    statement(
        "in the emulated loop our gains settle faster than [1, 2]", "-",
        above("mean difference less 4 standard errors (s)", "ahead[ours]", 0),
        computed="means {mean[ours]:.2f} s and {mean[reference]:.2f} s; {late[ours]:.0%} of the runs take more than 10 s",
        basis=RIG_BASIS,
    ),
)  # fmt: skip
