"""The controllers of Section 2.5 in the emulated loop: shipped experiments, sampled, packet by packet, with the same seeds.

And what the chapter improves on: gains of the Markov process that has the place of the semi-Markov one, with constant rates and
the same mean sojourns (Sections 1.1, 2.5, 4.2, 8.1).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from design.as_printed.examples import chapter2_process, chapter2_system
from design.processes.rates import constant_rate
from design.processes.semi_markov import SemiMarkov
from design.semi_markov_loop.robust_feedback import FeedbackRequest, fastest_feedback
from design.semi_markov_loop.second_moments import second_moment_decay
from hil.compose.loop import compose
from hil.experiment import load_experiment
from hil.measure.view import view_of
from hil.runtime.virtual import simulate
from hil.thesis.chapter import ReportProgress
from hil.thesis.statements import Statement, above

CONTROLLERS: Final = {"published": "smjls-robust-published", "reference": "smjls-robust-reference", "ours": "smjls-robust"}
"""(2.27), the gains of [1, 2], and ours."""

DURATION_S = 15.0
RUNS = 40
BAND = 0.015
"""Of |x(0)|, (2.28)."""

Array = npt.NDArray[np.float64]


def settled(name: str, seeds: Sequence[int], duration_s: float = DURATION_S) -> Array:
    """Return the settling times (2.28) of runs of a shipped experiment, s, (runs,).

    Args:
        name: of the experiment.
        seeds: one run each; modes and uncertainty of a run come from its seed, not from the gains.
        duration_s: length of a run; a run that has not settled counts as so long, infinite if safety stops it.
    """
    experiment = load_experiment(name, [f"duration={duration_s}", "allow_uncertified=true"])
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
        report_progress(f"{RUNS} runs of {name}", n, len(CONTROLLERS))
        times[who] = settled(name, range(RUNS))
    return comparison(times)


def comparison(times: dict[str, Array]) -> dict[str, Any]:
    """Return means, the share within 10 s, and what each is ahead of [1, 2], less four standard errors of the difference."""
    ahead = {who: times["reference"] - found for who, found in times.items() if who != "reference"}
    return {
        "mean": {who: found.mean() for who, found in times.items()},
        "late": {who: float((found > 10.0).mean()) for who, found in times.items()},
        "ahead": {who: d.mean() - 4.0 * d.std(ddof=1) / math.sqrt(d.size) for who, d in ahead.items()},
    }  # fmt: skip


BASIS = (
    f"{RUNS} runs of the shipped experiments, each of {DURATION_S:g} s at T = 5 ms, the same modes and uncertainty for all; the "
    f"rate h (2.26); a run that has not settled counts as {DURATION_S:g} s"
)
IN_THE_LOOP = (
    Statement(
        "in the emulated loop (2.27) settles faster than [1, 2]", "faster",
        (above("mean difference less 4 standard errors (s)", "ahead[published]", 0),),
        computed="means {mean[published]:.2f} s and {mean[reference]:.2f} s; {late[published]:.0%} and {late[reference]:.0%} of "
        "the runs take more than 10 s",
        basis=BASIS,
    ),
    Statement(
        "in the emulated loop our gains settle faster than [1, 2]", "-",
        (above("mean difference less 4 standard errors (s)", "ahead[ours]", 0),),
        computed="means {mean[ours]:.2f} s and {mean[reference]:.2f} s; {late[ours]:.0%} of the runs take more than 10 s",
        basis=BASIS,
    ),
)  # fmt: skip


POINTS = 100_000
"""Of the sojourn's distribution, over which it is averaged."""


def mean_sojourns(process: SemiMarkov) -> list[float]:
    """Return the mean sojourn of every mode, s."""
    shares = (np.arange(POINTS) + 0.5) / POINTS
    return [float(process.sojourn(mode, -np.log1p(-shares)).mean()) for mode in range(process.modes)]


def markov_approximation(process: SemiMarkov) -> SemiMarkov:
    """Return the Markov process of two modes with the mean sojourns of another.

    Raises:
        ValueError: it has not two modes, between which a rate alone does not say where a jump leads.
    """
    if process.modes != 2:
        raise ValueError(f"process: {process.modes} modes, expected 2")
    out, back = (constant_rate(1.0 / mean) for mean in mean_sojourns(process))
    return SemiMarkov(rates=((None, out), (back, None)))


BOUNDS = (5.0, 10.0, 30.0)
"""Bounds on the norm of the gains; those of [1, 2] have the norm 4.4, (2.27) has 26."""


def markov(report_progress: ReportProgress) -> dict[str, Any]:
    """Decay of the second moments over the rates (2.26), of gains for these rates and for constant ones."""
    process, nominal = chapter2_process(), chapter2_system("none")
    asked = {"markov": (markov_approximation(process), 1), "semi": (process, 2)}
    decay: dict[str, list[float]] = {name: [] for name in asked}
    for n, bound in enumerate(BOUNDS):
        report_progress(f"gain norm <= {bound:g}", n, len(BOUNDS))
        for name, (rates, sections) in asked.items():
            gain = fastest_feedback(nominal, FeedbackRequest(process=rates, gain_bound=bound, sections=sections)).gain
            assert gain is not None
            decay[name].append(second_moment_decay(nominal, gain, process))
    return decay | {"stay": mean_sojourns(process)[0]}


MARKOV = (
    Statement(
        "8.1: control improves on that by a Markov approximation", "improved",
        tuple(
            above(f"decay rate of E|x|^2 (1/s), gain norm <= {bound:g}", f"semi[{n}]", f"markov[{n}]")
            for n, bound in enumerate(BOUNDS)
        ),
        computed="{semi[0]:.3f}/s and {markov[0]:.3f}/s; {semi[1]:.3f}/s and {markov[1]:.3f}/s; {semi[2]:.3f}/s and "
        "{markov[2]:.3f}/s",
        basis="the nominal example, exact second moments over the rates (2.26). Gains of largest certified decay: two sections, "
        "linear in h; and one gain a mode for constant rates with the same mean sojourn of {stay:.4f} s",
    ),
)
