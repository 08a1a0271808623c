"""Chapter 4: active fault-tolerant control by semi-Markov models; the VTOL example of Section 4.4."""

from __future__ import annotations

from typing import Any

import numpy as np

from design.as_printed.examples import (
    CHAPTER4_START,
    chapter4_gain,
    chapter4_partitioned_gain,
    chapter4_process,
    chapter4_rate_knots,
    chapter4_seen_gain,
    chapter4_system,
)
from design.as_printed.fault_tolerant import printed_section
from design.controllers.scheduled_gain import ScheduledGain
from design.processes.rates import PiecewiseLinearRate
from design.processes.semi_markov import FaultDetection, SemiMarkov
from design.semi_markov_loop.certificate import JumpCertificate
from design.semi_markov_loop.fault_tolerant import fault_tolerant_feedback
from design.semi_markov_loop.fault_tolerant_analysis import analyse_fault_tolerant
from design.semi_markov_loop.period_moments import mean_square_abscissa
from design.semi_markov_loop.system import JumpSystem
from hil.thesis.chapter import Chapter, ReportProgress, Stage
from hil.thesis.chapter4.figures import averages, detection_fault, lifetimes, ratios, single_runs, text_rule
from hil.thesis.chapter4.further import CONSTRAINTS, OTHER_FAULTS, SENSOR_FAULT, constraints, other_faults, sensor_fault
from hil.thesis.chapter4.recomputed import DETECTION, ETA, ONE, RECOMPUTED, known_fault, recomputed
from hil.thesis.noisy_runs import NoisyRuns, fault_runs
from hil.thesis.statements import Statement, above, below, exactly, number_of, run, says

RUNS = 100
NOISE_S, OTHER_NOISE_S = 0.01, 0.1
PRINTED = {"(4.30)": "0.4606", "(4.31)": "0.3093"}
ASSUMED = "eta's rates linear over 0, 1, 2 s, r's over 0, 0.3, 0.6 s (no times are printed); a jump of eta leaves r's clock alone"


def _lifetimes(report_progress: ReportProgress) -> dict[str, Any]:
    """Figures 4.1 to 4.3."""
    return {"figures": (lifetimes(), detection_fault(_process()))}


def _conditions(report_progress: ReportProgress) -> dict[str, Any]:
    """Printed and sound conditions for the printed gains."""
    system, process = chapter4_system(), _process()
    whole, sections = chapter4_gain(), chapter4_partitioned_gain()
    single = printed_section(system, process, ONE, ONE, 0, whole)
    parts = [printed_section(system, process, ETA, DETECTION, m, sections[:, :, m]) for m in (0, 1)]
    sound = analyse_fault_tolerant(system, known_fault(sections), process, eta_nodes=ETA)
    report_progress("gains that see the detection only")
    ours, seen = _ours(), chapter4_seen_gain(partitioned=False)
    by_r = analyse_fault_tolerant(system, seen, process)
    by_r_parts = analyse_fault_tolerant(system, chapter4_seen_gain(partitioned=True), process)
    low, middle, high = chapter4_rate_knots()[0][:, 0, 1].tolist()
    return {
        "single": single, "parts": parts, "exact": analyse_fault_tolerant(system, known_fault(whole[:, :, None]), process),
        "sound": sound, "by_r": by_r, "ours": ours, "growth": -number_of(by_r.decay_rate),
        "undetected": float(np.linalg.eigvals(system.a[1] + system.b[1] @ seen.gain[0, 0]).real.max()),
        "by_r_parts": by_r_parts, "middle": middle, "centre": 0.5 * (low + high),
        "time": 1 / middle, "time_centre": 0.5 * (1 / low + 1 / high),
        "norm": [float(np.linalg.norm(k, 2)) for k in (whole[0, 0], *sections[0, 0])], **_pairs(),
    }  # fmt: skip


def _pairs() -> dict[str, Any]:
    """Corollary 4.3 accepts a scalar system in the section pairs (1, 1) and (2, 2) that diverges."""

    def step(first: float, second: float) -> PiecewiseLinearRate:
        return PiecewiseLinearRate(times_s=(0.0, 1.0, 1.0), values=(first, first, second))

    eta = SemiMarkov(rates=((None, step(0.1, 6.0)), (step(0.1, 6.0), None)))
    alarm, find = step(0.06, 1.2), step(3.0, 60.0)
    normal, faulty = SemiMarkov(rates=((None, alarm), (find, None))), SemiMarkov(rates=((None, find), (alarm, None)))
    process = FaultDetection(failure=eta, detection=(normal, faulty), failure_restarts_detection_clock=False)
    system = JumpSystem(a=np.full((2, 1, 1), 0.15), b=np.array([[[1.15]], [[-1.15]]]), c=np.ones((2, 1, 1)), e=np.ones((2, 1, 1)))
    gains = np.array([-1.0, 1.0]).reshape(2, 1, 1)
    sections = ((0.0, 1.0),) * 2
    rates = np.array([[0, 0.06, 6, 0], [3, 0, 0, 6], [6, 0, 0, 3], [0, 6, 0.06, 0]], dtype=float)
    return {
        "pairs": [
            printed_section(system, process, sections, sections, m, np.stack([gains, gains]), vertices=True).verdict
            for m in (0, 1)
        ],
        "pair_growth": mean_square_abscissa(np.array([[[-1.0]], [[1.3]], [[1.3]], [[-1.0]]]), rates),
    }


def _simulations(report_progress: ReportProgress) -> dict[str, Any]:
    """Runs of both controllers and of ours, with the same faults and noise."""
    gains = {name: known_fault(gain) for name, gain in zip(PRINTED, (chapter4_gain()[:, :, None], chapter4_partitioned_gain()))}
    ours = _ours().gain
    runs = {}
    for n, (name, gain) in enumerate([*gains.items(), *([("ours, sees r, |K| <= 2", ours)] if ours is not None else [])]):
        report_progress(f"{RUNS} runs, {name}", n, len(gains) + 1)
        runs[name if n > 1 else f"{name}, fault known"] = _simulate(gain)
    single, parts, *_ = runs.values()
    other = [_simulate(gain, noise_s=OTHER_NOISE_S).ratio for gain in gains.values()]
    less = parts.ratio - single.ratio
    error = float(less.std()) / RUNS**0.5
    over = [float(np.abs(r.x[:, :, 1]).max(axis=1).mean()) - 1.0 for r in (single, parts)]
    return {
        "figures": (single_runs(runs), averages(runs), ratios(runs)),
        "ratio": [[single.ratio, other[0]], [parts.ratio, other[1]]],
        "largest": [r.ratio.max() for r in (single, parts)], "less": less.mean(), "error": error,
        "surely": float(less.mean()) + 4.0 * error, "quotient": single.ratio.mean() / parts.ratio.mean(),
        "words": [
            "; ".join(f"{r.mean():.3f} +- {r.std():.3f} per run, largest {r.max():.3f}, noise held {t:g} s" for r, t in pair)
            for pair in (((kind.ratio, NOISE_S), (late, OTHER_NOISE_S)) for kind, late in zip((single, parts), other))
        ],
        "over": over, "half": 0.5 * over[0], "peak": [1 + each for each in over],
    }  # fmt: skip


def _text_rule(report_progress: ReportProgress) -> dict[str, Any]:
    """The printed gains as the text prescribes their use: the controller sees the detection only."""
    runs = [_simulate(chapter4_seen_gain(partitioned=parts), runs=20) for parts in (False, True)]
    return {"figures": (text_rule(*runs),)}


def _ours() -> JumpCertificate:
    return fault_tolerant_feedback(chapter4_system(), _process(), gain_bound=2.0)


def _process() -> FaultDetection:
    return chapter4_process(failure_restarts_detection_clock=False)


def _simulate(gain: ScheduledGain, runs: int = RUNS, noise_s: float = NOISE_S) -> NoisyRuns:
    return fault_runs(
        chapter4_system(), gain, _process(), start=CHAPTER4_START, runs=runs, duration_s=3.0, noise_s=noise_s, seed=4
    )


# fmt: off
CONDITIONS = (
    Statement(
        "gains (4.30) fulfil (4.26) at gamma = 1.5", "feasible",
        (says("(4.26)", "single.verdict", "certified"), below("smallest gamma", "single.gamma", 1.5)),
        computed="smallest gamma {single.gamma:.4f}; with exact rate vertices {exact.gamma:.4f}",
        basis="the fault is measured, K_ik",
    ),
    Statement(
        "gains (4.31) fulfil (4.27) at gamma = 1.5", "feasible",
        (
            *(says(f"(4.27), section {m + 1}", f"parts[{m}].verdict", "certified") for m in (0, 1)),
            *(below(f"smallest gamma of section {m + 1}", f"parts[{m}].gamma", 1.5) for m in (0, 1)),
            says("sound, two clocks", "sound.verdict", "certified"),
        ),
        computed="smallest gamma {parts[0].gamma:.4f}, {parts[1].gamma:.4f}; sound, two clocks: {sound.gamma:.4f}",
        basis="the fault is measured, K_ik,m; gamma = 1.5 is far from tight, so it does not decide between (4.30) and (4.31)",
    ),
    Statement(
        "u = K(r, h) x with (4.30), as (4.2)-(4.3) prescribe (K_kk)", "stochastically stable",
        (says("conditions", "by_r.verdict", "certified"),),
        (
            says("conditions", "by_r.verdict", "refused"), above("growth of E|x|^2 (1/s)", "growth", 0),
            above("largest eigenvalue of A_2 + B_2 K_11", "undetected", 0),
        ),
        computed="{by_r.verdict}: E|x|^2 grows like e^({growth:.2f} t)",
        basis="the LMIs give K_ik, the fault i is not measured; A_2 + B_2 K_11 has an eigenvalue at {undetected:+.2f}. "
        "Ours, which see r only, with gain norm <= 2: gamma {ours.gamma:.5f} {ours.verdict}",
    ),
    Statement(
        "u = K(r, h) x with (4.31) (K_kk,m)", "stochastically stable",
        (says("conditions", "by_r_parts.verdict", "certified"), below("gamma", "by_r_parts.gamma", 1.5)),
        basis=f"r's clock is the controller's; {ASSUMED}",
    ),
    Statement(
        "Corollary 4.3 is sufficient (scalar: -1 matched, +1.3 mismatched)", "stochastically stable",
        (below("growth of E x^2 (1/s)", "pair_growth", 0),),
        (
            *(says(f"sections ({m + 1},{m + 1})", f"pairs[{m}]", "certified") for m in (0, 1)),
            above("growth of E x^2 (1/s)", "pair_growth", 0),
        ),
        computed="section pairs (1,1), (2,2): {pairs[0]}, {pairs[1]}; growth of E x^2 {pair_growth:.4f}/s",
        basis="eta in section 2 with r in section 1; two clocks need all pairs",
    ),
    Statement(
        "sections meet at the mid-points of the rate bounds (4.28)", "0.5 between 0.333 and 1",
        (exactly("section bound (1/s)", "middle", "centre", 0.5e-3),),
        (exactly("its mean sojourn time (s)", "time", "time_centre", 0.5e-2),),
        computed="mid-point {centre:.3f}; of the mean sojourn times 1/{time_centre:.2f} = {middle:g}",
        basis="they are mid-points of the mean sojourn times, to the printed digits; the boundary in h is not printed",
    ),
    Statement(
        "the partition needs no larger gains: |K_11| > |K_11,1|, |K_11| > |K_11,2|", "Remark 4.6",
        (below("|K_11,1|", "norm[1]", "norm[0]"), below("|K_11,2|", "norm[2]", "norm[0]")),
        computed="{norm[0]:.1f} and {norm[1]:.1f}, {norm[0]:.1f} and {norm[2]:.1f}", basis="spectral norms",
    ),
)
BASIS = f"{RUNS} runs of 3 s, noise held {NOISE_S:g} s, fault known; {ASSUMED}"
SIMULATIONS = (
    *(
        Statement(
            f"||y|| / ||w||, gains {name}, with noise whose sample time is not printed", ratio,
            tuple(
                run(f"share of the runs, noise held {held:g} s, below {ratio}", f"ratio[{n}][{k}]", ratio)
                for k, held in enumerate((NOISE_S, OTHER_NOISE_S))
            ),
            computed=f"{{words[{n}]}}", readings=True,
            basis=f"{RUNS} runs of 3 s, fault known; {ASSUMED}; the transient from x_2(0) = 1 dominates",
        )
        for n, (name, ratio) in enumerate(PRINTED.items())
    ),
    Statement(
        "the ratio is below gamma = 1.5", "< 1.5",
        tuple(below(f"largest ratio, {name}", f"largest[{n}]", 1.5) for n, name in enumerate(PRINTED)),
        basis="one run's ratio bounds no gain: x(0) is not 0",
    ),
    Statement(
        "the partition reduces ||y|| for the same w", "Remark 4.6",
        (below("mean difference of the ratios plus 4 standard errors", "surely", 0),),
        computed="quotient of the mean ratios {quotient:.3f}; difference {less:.4f} +- {error:.4f}",
        basis=f"{BASIS}; the printed ratios have the quotient {0.4606 / 0.3093:.3f} (ours, not printed)",
    ),
    Statement(
        "overshoot of y is greatly reduced by the partition", "Figures 4.4 to 4.7",
        (below("mean overshoot with (4.31)", "over[1]", "half"),), computed="mean peak of |y| {peak[0]:.2f} and {peak[1]:.2f}",
        basis="|y(0)| = 1, so 1.00 means no overshoot at all; greatly: to less than half",
    ),
)
CHAPTER = Chapter(
    title="Chapter 4: fault-tolerant control by semi-Markov models",
    stages=(
        Stage("lifetimes", _lifetimes, 0.1),
        Stage("conditions", _conditions, 4, CONDITIONS),
        Stage("simulations", _simulations, 4, SIMULATIONS),
        Stage("gains of the corollaries", recomputed, 7, RECOMPUTED),
        Stage("gains that see r only", _text_rule, 0.3),
        Stage("a lost sensor", sensor_fault, 4, SENSOR_FAULT),
        Stage("disturbances that change, a Markov detection", other_faults, 7, OTHER_FAULTS),
        Stage("quadratic constraints", constraints, 4, CONSTRAINTS),
    ),
)
