"""Chapter 4: active fault-tolerant control by semi-Markov models; the VTOL example of Section 4.4."""

from __future__ import annotations

import math

import numpy as np

from design.as_printed.examples import (
    CHAPTER4_DETECTION_BOUNDARY_S,
    CHAPTER4_FAILURE_BOUNDARY_S,
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
from design.semi_markov_loop.growth import mean_square_abscissa
from design.semi_markov_loop.system import JumpSystem
from hil.reproduce.chapter import Chapter, Part, ReportProgress, Stage
from hil.reproduce.chapter4.figures import Ensemble, averages, detection_fault, lifetimes, ratios, single_runs, text_rule
from hil.reproduce.judgement import Row, above, below, near, rank, row, says
from hil.reproduce.noisy_runs import NoisyRuns, fault_runs

RUNS = 100
NOISE_S = 0.01
ONE = ((0.0,),) * 2
ETA, DETECTION = ((0.0, CHAPTER4_FAILURE_BOUNDARY_S),) * 2, ((0.0, CHAPTER4_DETECTION_BOUNDARY_S),) * 2
ASSUMED = "eta's rates linear over 0, 1, 2 s, r's over 0, 0.3, 0.6 s (no times are printed); a jump of eta leaves r's clock alone"


def _conditions(report_progress: ReportProgress) -> Part:
    """Printed and sound conditions for the printed gains."""
    rows = [*_printed()]
    report_progress("gains that see the detection only")
    return Part(rows=(*rows, *_seen(_ours()), _pairs(), _midpoints(), _norms()))


def _lifetimes(report_progress: ReportProgress) -> Part:
    """Figures 4.1 to 4.3."""
    return Part(figures=(lifetimes(), detection_fault(_process())))


def _simulations(report_progress: ReportProgress) -> Part:
    """Runs of both controllers and of ours, with the same faults and noise."""
    gains = {
        "(4.30), fault known": known_fault(chapter4_gain()[:, :, None]),
        "(4.31), fault known": known_fault(chapter4_partitioned_gain()),
    }
    ours = _ours().gain
    if ours is not None:
        gains["ours, sees r, |K| <= 2"] = ours
    runs = {}
    for n, (name, gain) in enumerate(gains.items()):
        report_progress(f"{RUNS} runs, {name}", n, len(gains))
        runs[name] = _simulate(gain)
    ensembles = {name: Ensemble(time_s=r.time_s, x=r.x, ratio=r.ratio) for name, r in runs.items()}
    return Part(rows=tuple(_simulated(runs)), figures=(single_runs(ensembles), averages(ensembles), ratios(ensembles)))


def _text_rule(report_progress: ReportProgress) -> Part:
    """The printed gains as the text prescribes their use: the controller sees the detection only."""
    diverging = _simulate(chapter4_seen_gain(partitioned=False), runs=20)
    calm = _simulate(chapter4_seen_gain(partitioned=True), runs=20)
    figure = text_rule(
        Ensemble(time_s=diverging.time_s, x=diverging.x, ratio=diverging.ratio),
        Ensemble(time_s=calm.time_s, x=calm.x, ratio=calm.ratio),
    )
    return Part(figures=(figure,))


CHAPTER = Chapter(
    title="Chapter 4: fault-tolerant control by semi-Markov models",
    stages=(
        Stage("lifetimes", _lifetimes, 0.1),
        Stage("conditions", _conditions, 4),
        Stage("simulations", _simulations, 4),
        Stage("gains that see r only", _text_rule, 0.3),
    ),
)


def _ours() -> JumpCertificate:
    return fault_tolerant_feedback(chapter4_system(), _process(), gain_bound=2.0)


def known_fault(gain: np.ndarray) -> ScheduledGain:
    """K_ik,m of shape (2, 2, sections, 2, 4) as a schedule over (eta, r) and r's clock."""
    sections = gain.reshape(4, -1, 2, 4)
    starts = np.array([[0.0, CHAPTER4_DETECTION_BOUNDARY_S][: sections.shape[1]]] * 4)
    return ScheduledGain(gain=sections, starts_s=starts, measured=("eta", "r"))


def _process() -> FaultDetection:
    return chapter4_process(failure_restarts_detection_clock=False)


def _simulate(gain: ScheduledGain, runs: int = RUNS) -> NoisyRuns:
    return fault_runs(
        chapter4_system(), gain, _process(), start=CHAPTER4_START, runs=runs, duration_s=3.0, noise_s=NOISE_S, seed=4
    )


def _printed() -> list[Row]:
    system, process = chapter4_system(), _process()
    single = printed_section(system, process, ONE, ONE, 0, chapter4_gain())
    exact = analyse_fault_tolerant(system, known_fault(chapter4_gain()[:, :, None]), process)
    parts = [printed_section(system, process, ETA, DETECTION, m, chapter4_partitioned_gain()[:, :, m]) for m in (0, 1)]
    sound = analyse_fault_tolerant(system, known_fault(chapter4_partitioned_gain()), process, eta_nodes=ETA)
    return [
        row(
            "gains (4.30) fulfil (4.26) at gamma = 1.5", "feasible",
            says("(4.26)", single.verdict, "certified"), below("smallest gamma", _gamma(single), 1.5),
            computed=f"smallest gamma {_gamma(single):.4f}; with exact rate vertices {_gamma(exact):.4f}",
            basis="the fault is measured, K_ik",
        ),
        row(
            "gains (4.31) fulfil (4.27) at gamma = 1.5", "feasible",
            *(says(f"(4.27), section {m + 1}", part.verdict, "certified") for m, part in enumerate(parts)),
            *(below(f"smallest gamma of section {m + 1}", _gamma(part), 1.5) for m, part in enumerate(parts)),
            says("sound, two clocks", sound.verdict, "certified"),
            computed=f"smallest gamma {_gamma(parts[0]):.4f}, {_gamma(parts[1]):.4f}; sound, two clocks: {_gamma(sound):.4f}",
            basis="the fault is measured, K_ik,m; gamma = 1.5 is far from tight, so it tells nothing of (4.30) against (4.31)",
        ),
    ]  # fmt: skip


def _gamma(certificate: JumpCertificate) -> float:
    return math.nan if certificate.gamma is None else certificate.gamma


def _seen(ours: JumpCertificate) -> list[Row]:
    system, process = chapter4_system(), _process()
    seen = chapter4_seen_gain(partitioned=False)
    single = analyse_fault_tolerant(system, seen, process)
    parts = analyse_fault_tolerant(system, chapter4_seen_gain(partitioned=True), process)
    undetected = float(np.linalg.eigvals(system.a[1] + system.b[1] @ seen.gain[0, 0]).real.max())
    growth = -(math.nan if single.decay_rate is None else single.decay_rate)
    return [
        row(
            "u = K(r, h) x with (4.30), as (4.2)-(4.3) prescribe (K_kk)", "stochastically stable",
            says("conditions", single.verdict, "certified"),
            computed=f"{single.verdict}: E|x|^2 grows like e^({growth:.2f} t)",
            witness=(
                says("conditions", single.verdict, "refused"), above("growth of E|x|^2 (1/s)", growth, 0.0),
                above("largest eigenvalue of A_2 + B_2 K_11", undetected, 0.0),
            ),
            basis=f"the LMIs give K_ik, the fault i is not measured; A_2 + B_2 K_11 has an eigenvalue at {undetected:+.2f}. "
            f"Ours, which see r only, with gain norm <= 2: gamma {_gamma(ours):.5f} {ours.verdict}",
        ),
        row(
            "u = K(r, h) x with (4.31) (K_kk,m)", "stochastically stable",
            says("conditions", parts.verdict, "certified"), below("gamma", _gamma(parts), 1.5),
            basis=f"r's clock is the controller's; {ASSUMED}",
        ),
    ]  # fmt: skip


def _pairs() -> Row:
    def step(first: float, second: float) -> PiecewiseLinearRate:
        return PiecewiseLinearRate(times_s=(0.0, 1.0, 1.0), values=(first, first, second))

    eta = SemiMarkov(rates=((None, step(0.1, 6.0)), (step(0.1, 6.0), None)))
    alarm, find = step(0.06, 1.2), step(3.0, 60.0)
    normal, faulty = SemiMarkov(rates=((None, alarm), (find, None))), SemiMarkov(rates=((None, find), (alarm, None)))
    process = FaultDetection(failure=eta, detection=(normal, faulty), failure_restarts_detection_clock=False)
    system = JumpSystem(a=np.full((2, 1, 1), 0.15), b=np.array([[[1.15]], [[-1.15]]]), c=np.ones((2, 1, 1)), e=np.ones((2, 1, 1)))
    gains = np.array([-1.0, 1.0]).reshape(2, 1, 1)
    sections = ((0.0, 1.0),) * 2
    passed = [
        printed_section(system, process, sections, sections, m, np.stack([gains, gains]), vertices=True).verdict for m in (0, 1)
    ]
    rates = np.array([[0, 0.06, 6, 0], [3, 0, 0, 6], [6, 0, 0, 3], [0, 6, 0.06, 0]], dtype=float)
    growth = mean_square_abscissa(np.array([[[-1.0]], [[1.3]], [[1.3]], [[-1.0]]]), rates)
    return row(
        "Corollary 4.3 is sufficient (scalar: -1 matched, +1.3 mismatched)", "stochastically stable",
        below("growth of E x^2 (1/s)", growth, 0.0),
        computed=f"section pairs (1,1), (2,2): {', '.join(passed)}; growth of E x^2 {growth:.4f}/s",
        witness=(
            *(says(f"sections ({m + 1},{m + 1})", verdict, "certified") for m, verdict in enumerate(passed)),
            above("growth of E x^2 (1/s)", growth, 0.0),
        ),
        basis="eta in section 2 with r in section 1; two clocks need all pairs",
    )  # fmt: skip


def _midpoints() -> Row:
    failure, _ = chapter4_rate_knots()
    low, middle, high = failure[:, 0, 1].tolist()
    meeting = near("section bound (1/s)", middle, 0.5 * (low + high), relative=0.01)
    of_times = near("its mean sojourn time (s)", 1 / middle, 0.5 * (1 / low + 1 / high), relative=0.01)
    return row(
        "sections meet at the mid-points of the rate bounds (4.28)", "0.5 between 0.333 and 1", meeting, witness=(of_times,),
        computed=f"mid-point {0.5 * (low + high):.3f}; of the mean sojourn times 1/{0.5 * (1 / low + 1 / high):.2f} = {middle:g}",
        basis="they are mid-points of the mean sojourn times; the boundary in h is not printed",
    )  # fmt: skip


def _norms() -> Row:
    single, parts = chapter4_gain()[0, 0], chapter4_partitioned_gain()[0, 0]
    one, two, three = (float(np.linalg.norm(k, 2)) for k in (single, *parts))
    return row(
        "the partition needs no larger gains: |K_11| > |K_11,1|, |K_11| > |K_11,2|", "Remark 4.6",
        below("|K_11,1|", two, one), below("|K_11,2|", three, one),
        computed=f"{one:.1f} and {two:.1f}, {one:.1f} and {three:.1f}", basis="spectral norms",
    )  # fmt: skip


def _simulated(runs: dict[str, NoisyRuns]) -> list[Row]:
    single, parts = runs["(4.30), fault known"], runs["(4.31), fault known"]
    over = [float(np.abs(r.x[:, :, 1]).max(axis=1).mean()) - 1.0 for r in (single, parts)]
    basis = f"{RUNS} runs of 3 s, noise held {NOISE_S:g} s, fault known; {ASSUMED}"
    rows = [
        row(
            f"||y|| / ||w||, gains {name}", f"{printed}", rank(f"share of the runs below {printed}", r.ratio, printed),
            computed=f"{r.ratio.mean():.3f} +- {r.ratio.std():.3f} per run, largest {r.ratio.max():.3f}",
            basis=f"{basis}; the transient from x_2(0) = 1 dominates",
        )
        for name, printed, r in (("(4.30)", 0.4606, single), ("(4.31)", 0.3093, parts))
    ]  # fmt: skip
    less = parts.ratio - single.ratio
    error = float(less.std()) / RUNS**0.5
    return [
        *rows,
        row(
            "the ratio is below gamma = 1.5", "0.4606, 0.3093 < 1.5",
            *(below(f"largest ratio, {n}", r.ratio.max(), 1.5) for n, r in (("(4.30)", single), ("(4.31)", parts))),
            basis="one run's ratio bounds no gain: x(0) is not 0",
        ),
        row(
            "the partition reduces ||y|| for the same w", "Remark 4.6",
            below("mean difference of the ratios plus 4 standard errors", float(less.mean()) + 4.0 * error, 0.0),
            computed=f"quotient of the mean ratios {single.ratio.mean() / parts.ratio.mean():.3f}; "
            f"difference {less.mean():.4f} +- {error:.4f}",
            basis=f"{basis}; the printed ratios have the quotient {0.4606 / 0.3093:.3f} (ours, not printed)",
        ),
        row(
            "overshoot of y is greatly reduced by the partition", "Figures 4.4 to 4.7",
            below("mean overshoot with (4.31)", over[1], 0.5 * over[0]),
            computed=f"mean peak of |y| {1 + over[0]:.2f} and {1 + over[1]:.2f}",
            basis="|y(0)| = 1, so 1.00 means no overshoot at all; greatly: to less than half",
        ),
    ]  # fmt: skip
