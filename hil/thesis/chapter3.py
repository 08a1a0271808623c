"""Chapter 3: H-infinity state feedback under time-varying delays; the VTOL example of Section 3.4."""

from __future__ import annotations

from typing import Any

import numpy as np

from design.as_printed import CHAPTER3_START, chapter3_gain, chapter3_process, chapter3_system
from design.as_printed.chapters_2_to_4 import delayed_section
from design.controllers.scheduled_gain import ScheduledGain, constant_gain
from design.processes.semi_markov import SemiMarkov
from design.semi_markov_loop import DelayedJumpSystem, JumpSystem
from design.semi_markov_loop.certificate import JumpCertificate
from design.semi_markov_loop.delayed_hinf import analyse_delayed, delayed_hinf
from design.semi_markov_loop.stability import analyse
from hil.pages import BarGroup, Bars, Figure, Series
from hil.thesis import Chapter, Plot, ReportProgress, Stage
from hil.thesis.chapter3_partitions import BOUNDS, FURTHER, PARTITIONS, SECTIONS, WHOLE, further, partitions
from hil.thesis.judgement import rank
from hil.thesis.noisy_runs import NoisyRuns, delayed_runs
from hil.thesis.statements import above, below, number_of, run, says, statement

STATES = ("horizontal velocity", "vertical velocity", "pitch rate", "pitch angle")
UNITS = ("knot", "knot", "deg/s", "deg")
CASES = ((20.0, 1.0), (10.0, 0.5), (10.0, 0.01), (20.0, 0.01))
"""Length of a run and sample time of the noise, s."""

HELD = (0.01, 0.1)
RATIO = "0.2320"
RUNS, MORE = 200, 1200
"""Runs of each case; of a case that the first leave undecided, others in their place."""

RAMP = "rates linear over 0, 1.8, 3.6 s (only their bounds are printed)"


def _conditions(report_progress: ReportProgress) -> dict[str, Any]:
    """The printed conditions for the printed gains, and what they miss."""
    system, process, gain = chapter3_system(), chapter3_process(), chapter3_gain()
    literal = [delayed_section(system, process, SECTIONS, m, gain, reading="literal", gamma=0.93) for m in (0, 1)]
    consistent = [delayed_section(system, process, SECTIONS, m, gain, reading="consistent") for m in (0, 1)]
    system = DelayedJumpSystem(
        a=np.array([[[-1.0, 100.0], [0.0, -1.0]]]), ad=np.zeros((1, 2, 2)), b=np.array([[[0.0], [1.0]]]),
        e=np.array([[[0.0], [1.0]]]), c=np.array([[[1.0, 0.0]]]), delay_max_s=0.1, delay_slopes=np.zeros(1),
    )  # fmt: skip
    process, gain = SemiMarkov(rates=((None,),)), constant_gain(np.zeros((1, 1, 2)))
    omega = np.geomspace(1e-4, 1e2, 400)[:, None, None]
    response = system.c[0] @ np.linalg.solve(1j * omega * np.eye(2) - system.a[0], system.e[0] + 0j)
    return {
        "literal": literal, "why": [each.reason.rpartition(": ")[2] for each in literal], "consistent": consistent,
        "peak": float(np.abs(response).max()),
        "accepted": delayed_section(system, process, ((0.0,),), 0, gain, gamma=0.05),
        "corrected": analyse_delayed(system, gain, process).gamma,
    }  # fmt: skip


def _sound(report_progress: ReportProgress) -> dict[str, Any]:
    """Certified levels, of the printed gains and of ours."""
    process, system, ours = chapter3_process(), chapter3_system(), {}
    for n, bound in enumerate(BOUNDS):
        report_progress(f"synthesis, gain norm <= {bound:g}", n, len(BOUNDS) + 2)
        ours[bound] = delayed_hinf(system, process, gain_bound=bound, sections=SECTIONS)
    report_progress("synthesis, one section", len(BOUNDS), len(BOUNDS) + 2)
    whole = [number_of(delayed_hinf(system, process, gain_bound=bound, sections=WHOLE).gamma) for bound in BOUNDS]
    halves = [number_of(ours[bound].gamma) for bound in BOUNDS]
    report_progress("levels of the printed gains", len(BOUNDS) + 1, len(BOUNDS) + 2)
    published = analyse_delayed(system, chapter3_gain(), process)
    ramp = analyse_delayed(system, chapter3_gain(), process, method="pwl", nodes=((0.0, 0.9, 1.8, 2.7, 3.6),) * 3)
    return {
        "figures": (_trajectories(chapter3_gain(), ours[5.0].gain), _levels_plot(published, ours)),
        "unforced": -number_of(analyse(JumpSystem(a=system.a + system.ad, b=system.b), None, process, method="exact").decay_rate),
        "published": published, "ramp": ramp.gamma, "norm": chapter3_gain().norm,
        "whole": whole, "halves": halves, "gain": [one / two for one, two in zip(whole, halves, strict=True)],
        "frozen": _frozen_norm(system, chapter3_gain()),
        "made": "; ".join(f"gain norm <= {bound:g}: gamma {certificate.gamma:.4f}" for bound, certificate in ours.items()),
    }  # fmt: skip


def _frozen_norm(system: DelayedJumpSystem, gain: ScheduledGain) -> float:
    worst = 0.0
    omega = np.geomspace(1e-2, 1e2, 300)
    for i in range(system.modes):
        for section in range(2):
            loop = system.a[i] + system.b[i] @ gain.gain[i, section]
            for tau in (0.0, 0.1, 0.2, 0.3):
                wave = np.exp(-1j * omega * tau)[:, None, None]
                resolvent = 1j * omega[:, None, None] * np.eye(4) - loop - system.ad[i] * wave
                worst = max(
                    worst,
                    float(np.linalg.norm(system.c[i] @ np.linalg.solve(resolvent, system.e[i] + 0j), axis=(1, 2)).max()),
                )
    return worst


def _runs(gain: ScheduledGain, runs: int, duration_s: float, noise_s: float, **more: object) -> NoisyRuns:
    return delayed_runs(
        chapter3_system(), gain, chapter3_process(), runs=runs, duration_s=duration_s, noise_s=noise_s,
        **{"start": CHAPTER3_START, **more},  # type: ignore[arg-type]
    )  # fmt: skip


def _simulations(report_progress: ReportProgress) -> dict[str, Any]:
    """The norm ratio and the vertical velocity, which depend on what the text does not print."""
    gain = chapter3_gain()
    ratios = []
    for n, (t, ts) in enumerate(CASES):
        report_progress(f"{RUNS} runs of {t:g} s, noise held {ts:g} s", n, len(CASES) + 3)
        ratios.append(_runs(gain, RUNS, t, ts).ratio)
        if rank("", ratios[n], float(RATIO)).undecided:
            report_progress(f"{MORE} further runs of {t:g} s, noise held {ts:g} s", n, len(CASES) + 3)
            ratios[n] = np.concatenate([_runs(gain, MORE // 3, t, ts, seed=seed).ratio for seed in (1, 2, 3)])
    report_progress("runs without noise, and from rest", len(CASES), len(CASES) + 3)
    quiet = _runs(gain, 50, 20.0, 1.0, noise=False).size
    rest = _runs(gain, 50, 10.0, 0.01, start=(0.0, 0.0, 0.0, 0.0)).ratio
    rms, peak = [], []
    for n, held in enumerate(HELD):
        report_progress(f"vertical velocity, noise held {held:g} s", len(CASES) + 1 + n, len(CASES) + 3)
        many = _runs(gain, 20, 10.0, held)
        late = many.x[:, many.time_s > 5.0, 1]
        rms.append(float(np.sqrt((late * late).mean())))
        peak.append(float(np.abs(late).max(axis=1).mean()))
    said = zip(CASES, ratios, strict=True)
    return {
        "ratios": ratios, "runs": [len(ratio) for ratio in ratios], "largest": max(float(ratio.max()) for ratio in ratios),
        "words": "; ".join(f"{r.mean():.3f} +- {r.std():.3f} per run of {t:g} s, noise held {ts:g} s" for (t, ts), r in said),
        "rest": rest.mean(), "quiet": quiet.mean(), "rms": rms, "peak": peak,
    }  # fmt: skip


def _trajectories(published: ScheduledGain, ours: ScheduledGain | None) -> Plot:
    first = _runs(published, 1, 20.0, 0.1, seed=1)
    panels = []
    other = None if ours is None else _runs(ours, 1, 20.0, 0.1, seed=1)
    for n, (name, unit) in enumerate(zip(STATES, UNITS)):
        series = [Series(label="printed gains", x=first.time_s, y=first.x[0, :, n])]
        if other is not None:
            series.append(Series(label="ours, |K| <= 5", x=other.time_s, y=other.x[0, :, n], style="dashed"))
        panels.append(Figure(title=f"3.2: x{n + 1}", y_label=name, y_unit=unit, series=tuple(series)))
    intro = "One run from the printed initial state, same modes, delay and noise."
    return Plot(title="Figure 3.2", panels=tuple(panels), intro=intro)


def _levels_plot(published: JumpCertificate, ours: dict[float, JumpCertificate]) -> Plot:
    names = ["claimed", "printed gains", *(f"ours, |K| <= {bound:g}" for bound in ours)]
    values = [0.93, published.gamma or 0.0, *(certificate.gamma or 0.0 for certificate in ours.values())]
    bars = Bars(title="certified gamma", categories=names, groups=(BarGroup(label="gamma", values=values),), y_label="gamma")
    return Plot(title="Levels", panels=(bars,), intro=f"Printed gains have norm {chapter3_gain().norm:.2f}.")


# fmt: off
CONDITIONS = (
    *(
        each
        for m in (0, 1)
        for each in (
            statement(
                f"gains of section {m + 1} fulfil (3.42) at gamma = 0.93, as printed", "feasible",
                says("(3.42)", f"literal[{m}].verdict", "certified"),
                witness=(says("(3.42)", f"literal[{m}].verdict", "refused"),),
                computed=f"{{literal[{m}].verdict}}", basis=f"{{why[{m}]}}",
            ),
            statement(
                f"section {m + 1} with one rate in both places, (3.41)", "feasible",
                says("(3.41)", f"consistent[{m}].verdict", "certified"),
                below("smallest gamma", f"consistent[{m}].gamma", 0.93),
                computed=f"{{consistent[{m}].verdict}}, smallest gamma {{consistent[{m}].gamma:.3f}}",
                basis="what the author must have solved; C'C and B'P still stand in the wrong coordinates",
            ),
        )
    ),
    statement(
        "Theorem 3.1 bounds the norm: A = [-1 100; 0 -1], B = [0; 1], C = [1 0], no delay", "||z|| < gamma ||w||",
        below("peak of |C (jw I - A)^-1 B|", "peak", 0.05),
        witness=(says("(3.27) at gamma = 0.05", "accepted.verdict", "certified"), above("peak of the response", "peak", 0.05)),
        computed="(3.27) at gamma = 0.05: {accepted.verdict}; peak of the response {peak:.1f}; corrected condition: gamma >= "
        "{corrected:.1f}",
        basis="C (sI - A)^-1 B = 100/(s + 1)^2 has the norm 100; (3.27) is the bounded real lemma of (A', B, C)",
    ),
)
LEVELS = (
    statement(
        "the unforced VTOL is unstable", "unstable", above("growth of E|x|^2 without delays (1/s)", "unforced", 0),
        basis=f"exact second moments of A_i + A_di; {RAMP}",
    ),
    statement(
        "gamma = 0.93 holds for the printed gains", "0.93",
        says("corrected condition", "published.verdict", "certified"), below("gamma", "published.gamma", 0.93),
        computed="{published.verdict} {published.gamma:.3f} (norm of the gains {norm:.2f}); with known ramps {ramp:.3f}; "
        "ours: {made}",
        basis=f"corrected, one Q, one eta = 4.0, linked sections; {RAMP}; no frozen mode exceeds {{frozen:.3f}}",
    ),
)
CONSERVATIVENESS = statement(
    "3.3.3: two partitions (Corollary 3.2) are less conservative than one (Corollary 3.1), corrected", "less conservative",
    *(
        above(f"smallest certified gamma of M = 1 over that of M = 2, gain norm <= {bound:g}", f"gain[{n}]", 1.01)
        for n, bound in enumerate(BOUNDS)
    ),
    computed="{whole[0]:.4f} with M = 1, {halves[0]:.4f} with M = 2; {whole[1]:.4f}, {halves[1]:.4f}", readings=True,
    basis="the corrected condition with linked sections; less by a hundredth, for each bound of the gains (none is printed)",
)
SIMULATIONS = (
    statement(
        "||z|| / ||w|| in the simulation, whose length and sample time of the noise are not printed", RATIO,
        *(
            run(f"share of {{runs[{n}]}} runs of {t:g} s, noise held {ts:g} s, below {RATIO}", f"ratios[{n}]", RATIO)
            for n, (t, ts) in enumerate(CASES)
        ),
        computed="{words}", readings=True,
        basis="it depends on both; x(0) != 0, so it is no estimate of gamma (from x(0) = 0, noise held 0.01 s: {rest:.3f}, "
        "without noise sqrt(int z^2) = {quiet:.2f})",
    ),
    statement(
        "the ratio is below gamma = 0.93", "< 0.93", below("largest ratio of all these runs", "largest", 0.93), basis=RAMP,
    ),
    statement(
        "vertical velocity falls from 6 m/s to less than 1 m/s, with noise whose sample time is not printed", "< 1",
        *(below(f"rms of x_2 from 5 to 10 s, noise held {held:g} s", f"rms[{n}]", 1.0) for n, held in enumerate(HELD)),
        readings=True, basis=f"20 runs each, mean peaks {{peak[0]:.2f}} and {{peak[1]:.2f}}; {RAMP}",
    ),
)
CHAPTER = Chapter(
    title="Chapter 3: H-infinity control under time-varying delays",
    stages=(
        Stage("printed conditions", _conditions, 5, CONDITIONS),
        Stage("interval matrices, decay and partitions", partitions, 6, PARTITIONS),
        Stage("sound levels", _sound, 17, (*LEVELS, CONSERVATIVENESS)),
        Stage("gains and delays", further, 5, FURTHER),
        Stage("simulations", _simulations, 40, SIMULATIONS),
    ),
)
# fmt: on
