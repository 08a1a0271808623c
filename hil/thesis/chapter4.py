"""Chapter 4: fault-tolerant control by semi-Markov models; the VTOL example of Section 4.4.

What the conditions of the corollaries say of the printed gains (4.30), (4.31), and what the chapter's remarks add: other faults
(4.1), a Markov detection (4.2), a quadratic constraint for the norm (4.4).
"""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from typing import Any

import numpy as np

from design.as_printed import chapter4_gain, chapter4_partitioned_gain, chapter4_rate_knots, chapter4_seen_gain, chapter4_system
from design.as_printed.chapters_2_to_4 import detection_section
from design.errors import Infeasible
from design.processes.rates import PiecewiseLinearRate
from design.processes.semi_markov import FaultDetection, SemiMarkov
from design.semi_markov_loop import JumpSystem
from design.semi_markov_loop.fault_tolerant import fault_tolerant_feedback
from design.semi_markov_loop.fault_tolerant_analysis import Siqc, analyse_fault_tolerant, mean_square_abscissa, worst_growth
from hil.certify.jump_loop import process_of, system_of
from hil.compose import compose
from hil.experiment import load_experiment
from hil.thesis import Array, Chapter, ReportProgress, Stage
from hil.thesis import chapter4_simulations as runs
from hil.thesis.chapter2_feasibility import markov_approximation
from hil.thesis.chapter4_simulations import ASSUMED, DETECTION, ETA, ONE, faults, known_fault, largest_entry, our_gains
from hil.thesis.statements import above, below, exactly, number_of, says, statement
from plants.vtol_fault import FaultyVTOL

EXPERIMENT = "vtol-sensor-fault"
GAIN_BOUND = 2.0
LARGER = 3.0
"""E of mode 2 over that of mode 1."""
AROUND = (1.02, 0.9)
"""Levels over the smallest gamma of some gains: above it, and below."""
GENERAL = (np.array([[1.0]]), np.array([[0.01, 0.0]]), -1e-3 * np.eye(2))
TIGHT = 1e-5
"""-Gamma_22 that no gains within the bound meet."""


def sensor_fault(report_progress: ReportProgress) -> dict[str, Any]:
    """Gains that know that the sensor may be lost, gains that do not, and the shipped loop as it runs."""
    plant = load_experiment(EXPERIMENT).plant
    assert isinstance(plant, FaultyVTOL)
    process = process_of(plant.jump_process())
    system, sound = (system_of(each.jump_system()) for each in (plant, FaultyVTOL(fault_effectiveness=1.0)))
    assert isinstance(process, FaultDetection) and isinstance(system, JumpSystem) and isinstance(sound, JumpSystem)
    ours = fault_tolerant_feedback(system, process, gain_bound=GAIN_BOUND)
    report_progress("gains that do not know of it", 1, 3)
    blind = fault_tolerant_feedback(sound, process, gain_bound=GAIN_BOUND).gain
    assert blind is not None and ours.gain is not None
    unaware = analyse_fault_tolerant(system, blind, process)
    report_progress("the loop at T", 2, 3)
    verdict = compose(load_experiment(EXPERIMENT, ["allow_uncertified=true"])).verdict
    growth = worst_growth(system, ours.gain, process)
    return {
        "A": _change(system.a), "B": _change(system.b), "E": _change(system.e),
        "lost": float(np.abs(system.shown(1) - system.shown(0)).max()), "ours": ours,
        "unaware": math.inf if unaware.verdict == "refused" else unaware.gamma, "unaware_word": unaware.verdict,
        "loop": "none" if verdict is None else verdict.state, "growth": growth and growth[0],
    }  # fmt: skip


SENSOR_FAULT = (
    statement(
        "Remark 4.1: a lost sensor is a mode of (4.1) that differs in what is measured alone, and gains exist for it",
        "can accommodate different types of fault scenarios",
        exactly("largest change of A", "A", 0.0, 1e-12),
        exactly("largest change of B", "B", 0.0, 1e-12),
        exactly("largest change of E", "E", 0.0, 1e-12),
        above("largest change of what is measured", "lost", 0),
        says("(4.14), (4.23) with K_k S_i", "ours.verdict", "certified"),
        below("growth of E|x|^2 at the worst constant rates (1/s)", "growth", 0),
        says(f"{EXPERIMENT} at T = 1 ms", "loop", "certified"),
        computed="gamma {ours.gamma:.4f}, E|x|^2 grows at {growth:.3g}/s at most; the loop at T = 1 ms: {loop}",
        basis=f"the VTOL of Section 4.4 with sound actuators; in mode 2 the sensor of the pitch angle shows 0; gain norm <= "
        f"{GAIN_BOUND:g}, the controller sees r",
    ),
    statement(
        "Remark 4.1: gains that know of the sensor fault attenuate better under it than gains that do not", "-",
        below("gamma over that of gains for sound sensors", "ours.gamma", "unaware"),
        computed="gamma {ours.gamma:.4f} against {unaware:.4f} ({unaware_word})",
        basis="the same gain bound, rates and fault",
    ),
)  # fmt: skip


def other_faults(report_progress: ReportProgress) -> dict[str, Any]:
    """Gains for disturbances that a fault makes larger, and gains for a detection whose rates are taken as constant."""
    system, process = chapter4_system(), faults()
    assert system.e is not None and system.c is not None
    rough = replace(system, b=np.stack([system.b[0]] * 2), e=np.stack([system.e[0], LARGER * system.e[0]]))
    ours = fault_tolerant_feedback(rough, process, gain_bound=GAIN_BOUND)
    calm = fault_tolerant_feedback(replace(rough, e=np.stack([system.e[0]] * 2)), process, gain_bound=GAIN_BOUND)
    growth = None if ours.gain is None else worst_growth(rough, ours.gain, process)
    report_progress("gains for a Markov detection", 1, 2)
    simple = replace(process, detection=tuple(markov_approximation(each) for each in process.detection))
    by_markov = fault_tolerant_feedback(system, simple, gain_bound=GAIN_BOUND).gain
    assert by_markov is not None
    over = analyse_fault_tolerant(system, by_markov, process)
    known = fault_tolerant_feedback(system, process, gain_bound=GAIN_BOUND)
    return {
        "same": float(np.max([_change(rough.a), _change(rough.b), _change(rough.c)])), "E": _change(rough.e), "rough": ours,
        "calm": calm, "growth": growth and growth[0], "over": over, "known": known,
    }  # fmt: skip


def _change(matrices: Array | None) -> float:
    return math.nan if matrices is None else float(np.abs(matrices[1] - matrices[0]).max())


OTHER_FAULTS = (
    statement(
        "Remark 4.1: a fault of what disturbs is a mode of (4.1) that differs in E alone, and gains exist for it",
        "by tuning E(eta)",
        exactly("largest change of A, B and C", "same", 0.0, 1e-12),
        above("largest change of E", "E", 0),
        says("(4.14), (4.23)", "rough.verdict", "certified"),
        below("growth of E|x|^2 at the worst constant rates (1/s)", "growth", 0),
        above("gamma over that without the fault", "rough.gamma", "calm.gamma"),
        computed="gamma {rough.gamma:.5f}, without the fault {calm.gamma:.5f}; E|x|^2 grows at {growth:.3g}/s at most",
        basis=f"the VTOL of Section 4.4 with sound actuators; in mode 2 E is {LARGER:g} times as large; gain norm <= "
        f"{GAIN_BOUND:g}, the controller sees r",
    ),
    statement(
        "4.2: a Markov process may take the place of the detection in the design", "could be implemented",
        says("its gains over the semi-Markov detection, (4.14), (4.23)", "over.verdict", "certified"),
        computed="{over.verdict}: gamma {over.gamma:.4g}, of gains that know the rates {known.gamma:.4g}",
        basis=f"constant rates of r with the same mean sojourns; gain norm <= {GAIN_BOUND:g}. Both gains are descents to near "
        "their minima, so the difference is no claim",
    ),
)  # fmt: skip


def constraints(report_progress: ReportProgress) -> dict[str, Any]:
    """Levels of gains by both conditions, and gains for a general Gamma."""
    system, process = chapter4_system(), faults()
    plain = fault_tolerant_feedback(system, process, gain_bound=GAIN_BOUND)
    assert plain.gain is not None
    gamma = plain.gamma or math.nan
    report_progress("constraints with I, 0, -gamma^2 I", 1, 3)
    words = []
    for share in AROUND:
        level = Siqc(g11=np.eye(1), g12=np.zeros((1, 2)), g22=-((share * gamma) ** 2) * np.eye(2))
        words.append(analyse_fault_tolerant(system, plain.gain, process, performance=level).verdict)
    report_progress("gains for a general Gamma", 2, 3)
    wanted = Siqc(g11=GENERAL[0], g12=GENERAL[1], g22=GENERAL[2])
    found = fault_tolerant_feedback(system, process, gain_bound=GAIN_BOUND, performance=wanted)
    return {
        "gamma": gamma, "above": words[0], "below": words[1], "general": found,
        "norm": 0.0 if found.gain is None else found.gain.norm, "margin": found.check(), "tight": _tight(system, process),
    }  # fmt: skip


def _tight(system: Any, process: Any) -> str:
    asked = Siqc(g11=GENERAL[0], g12=GENERAL[1], g22=-TIGHT * np.eye(2))
    try:
        return str(fault_tolerant_feedback(system, process, gain_bound=GAIN_BOUND, performance=asked).verdict)
    except Infeasible as error:
        return "refused" if error.proved else "undecided"


CONSTRAINTS = (
    statement(
        "Remark 4.4: Gamma_11 = I, Gamma_12 = 0, Gamma_22 = -gamma^2 I reduce (4.6) to the H-infinity performance (4.5)",
        "reduces to the standard H-infinity performance",
        says(f"(4.6) at {AROUND[0]:g} gamma", "above", "certified"), says(f"(4.6) at {AROUND[1]:g} gamma", "below", "refused"),
        computed=f"gamma {{gamma:.5f}} by (4.5); (4.6): {{above}} at {AROUND[0]:g} of it, {{below}} at {AROUND[1]:g} of it",
        basis=f"our gains that see r, gain norm <= {GAIN_BOUND:g}; refused: dual matrices prove that no matrices exist",
    ),
    statement(
        "(4.6) with Gamma_12 != 0: gains that meet it exist", "by tuning these matrices",
        says("(4.23) for the gains found", "general.verdict", "certified"),
        above("margin of its inequalities, computed anew", "margin", 0),
        computed="{general.verdict}, margin {margin:.3g}, gain norm {norm:.3g}",
        basis=f"Gamma_11 = 1, Gamma_12 = [0.01 0], Gamma_22 = -0.001 I; with Gamma_22 = -{TIGHT:g} I the answer is '{{tight}}'",
    ),
)  # fmt: skip

FAILURE, DETECTIONS = chapter4_rate_knots()


def _conditions(report_progress: ReportProgress) -> dict[str, Any]:
    """Printed and sound conditions for the printed gains."""
    system, process = chapter4_system(), faults()
    whole, sections = chapter4_gain(), chapter4_partitioned_gain()
    single = detection_section(system, process, ONE, ONE, 0, whole)
    parts = [detection_section(system, process, ETA, DETECTION, m, sections[:, :, m]) for m in (0, 1)]
    sound = analyse_fault_tolerant(system, known_fault(sections), process, eta_nodes=ETA)
    report_progress("gains that see the detection only")
    ours, seen = our_gains(), chapter4_seen_gain(partitioned=False)
    by_r = analyse_fault_tolerant(system, seen, process)
    by_r_parts = analyse_fault_tolerant(system, chapter4_seen_gain(partitioned=True), process)
    low, middle, high = np.concatenate([knots[:, (0, 1), (1, 0)] for knots in (FAILURE, *DETECTIONS)], axis=1)
    return {
        "single": single, "parts": parts, "exact": analyse_fault_tolerant(system, known_fault(whole[:, :, None]), process),
        "sound": sound, "by_r": by_r, "ours": ours, "growth": -number_of(by_r.decay_rate),
        "undetected": float(np.linalg.eigvals(system.a[1] + system.b[1] @ seen.gain[0, 0]).real.max()),
        "by_r_parts": by_r_parts, "away": largest_entry(middle - 0.5 * (low + high)),
        "away_s": largest_entry(middle - 2.0 / (1.0 / low + 1.0 / high)), "smallest": float(middle.min()),
        "norm": [float(np.linalg.norm(k, 2)) for k in (whole[0, 0], *sections[0, 0])],
        "grown": float((np.linalg.norm(sections, 2, axis=(3, 4)) / np.linalg.norm(whole, 2, axis=(2, 3))[:, :, None]).max()),
        **_pairs(),
    }  # fmt: skip


def _pairs() -> dict[str, Any]:
    """Corollary 4.3 accepts a scalar system in the section pairs (1, 1) and (2, 2) that diverges in the pair (2, 1)."""

    def step(first: float, second: float) -> PiecewiseLinearRate:
        return PiecewiseLinearRate(times_s=(0.0, 1.0, 1.0), values=(first, first, second))

    eta = SemiMarkov(rates=((None, step(0.1, 6.0)), (step(0.1, 6.0), None)))
    alarm, find = step(0.06, 1.2), step(3.0, 60.0)
    normal, faulty = SemiMarkov(rates=((None, alarm), (find, None))), SemiMarkov(rates=((None, find), (alarm, None)))
    process = FaultDetection(failure=eta, detection=(normal, faulty), failure_restarts_detection_clock=False)
    system = JumpSystem(a=np.full((2, 1, 1), 0.15), b=np.array([[[1.15]], [[-1.15]]]), c=np.ones((2, 1, 1)), e=np.ones((2, 1, 1)))
    gains = np.array([-1.0, 1.0]).reshape(2, 1, 1)
    sections = ((0.0, 1.0),) * 2
    rates, loops = np.zeros((4, 4)), np.zeros((4, 1, 1))
    for at, (i, k) in enumerate(itertools.product((0, 1), (0, 1))):
        loops[at] = system.a[i] + system.b[i] @ gains[k]
        rates[at, 2 * (1 - i) + k] = eta.bounds(i, 1.0, math.inf)[1][1 - i]
        rates[at, 2 * i + 1 - k] = process.detection[i].bounds(k, 0.0, 1.0)[1][1 - k]
    return {
        "pairs": [
            detection_section(system, process, sections, sections, m, np.stack([gains, gains]), vertices=True).verdict
            for m in (0, 1)
        ],
        "pair_growth": mean_square_abscissa(loops, rates),
    }


# fmt: off
CONDITIONS = (
    statement(
        "gains (4.30) fulfil (4.26) at gamma = 1.5", "feasible",
        says("(4.26)", "single.verdict", "certified"), below("smallest gamma", "single.gamma", 1.5),
        computed="smallest gamma {single.gamma:.4f}; with exact rate vertices {exact.gamma:.4f}",
        basis="the fault is measured, K_ik",
    ),
    statement(
        "gains (4.31) fulfil (4.27) at gamma = 1.5", "feasible",
        *(says(f"(4.27), section {m + 1}", f"parts[{m}].verdict", "certified") for m in (0, 1)),
        *(below(f"smallest gamma of section {m + 1}", f"parts[{m}].gamma", 1.5) for m in (0, 1)),
        says("sound, two clocks", "sound.verdict", "certified"), below("smallest gamma of that", "sound.gamma", 1.5),
        computed="smallest gamma {parts[0].gamma:.4f}, {parts[1].gamma:.4f}; sound, two clocks: {sound.gamma:.4f}",
        basis="the fault is measured, K_ik,m; gamma = 1.5 is far from tight, so it does not decide between (4.30) and (4.31)",
    ),
    statement(
        "u = K(r, h) x with (4.30), as (4.2)-(4.3) prescribe (K_kk)", "stochastically stable",
        says("conditions", "by_r.verdict", "certified"),
        witness=(
            says("conditions", "by_r.verdict", "refused"), above("growth of E|x|^2 (1/s)", "growth", 0),
            above("largest eigenvalue of A_2 + B_2 K_11", "undetected", 0),
        ),
        computed="{by_r.verdict}: E|x|^2 grows like e^({growth:.2f} t)",
        basis="the LMIs give K_ik, the fault i is not measured; A_2 + B_2 K_11 has an eigenvalue at {undetected:+.2f}. "
        "Ours, which see r only, with gain norm <= 2: gamma {ours.gamma:.5f} {ours.verdict}",
    ),
    statement(
        "u = K(r, h) x with (4.31) (K_kk,m)", "stochastically stable",
        says("conditions", "by_r_parts.verdict", "certified"), below("gamma", "by_r_parts.gamma", 1.5),
        basis=f"r's clock is the controller's; {ASSUMED}",
    ),
    statement(
        "Corollary 4.3 is sufficient (scalar: -1 matched, +1.3 mismatched)", "stochastically stable",
        below("growth of E x^2 (1/s)", "pair_growth", 0),
        witness=(
            *(says(f"sections ({m + 1},{m + 1})", f"pairs[{m}]", "certified") for m in (0, 1)),
            above("growth of E x^2 (1/s)", "pair_growth", 0),
        ),
        computed="section pairs (1,1), (2,2): {pairs[0]}, {pairs[1]}; growth of E x^2 {pair_growth:.4f}/s",
        basis="eta in section 2 with r in section 1; two clocks need all pairs",
    ),
    statement(
        "sections meet at the mid-points of the rate bounds (4.28)", "0.5 between 0.333 and 1, and five others",
        exactly("largest distance from a mid-point (1/s)", "away", 0, 0.5e-3, "smallest"),
        witness=(
            exactly("largest distance from the rate of the mean of both sojourn times (1/s)", "away_s", 0, 0.5e-3, "smallest"),
        ),
        basis="they are mid-points of the mean sojourn times, to the printed digits; the boundary in h is not printed",
    ),
    statement(
        "the partition needs no larger gains: |K_11| > |K_11,1|, |K_11| > |K_11,2|", "Remark 4.6",
        below("largest |K_ik,m| over |K_ik|, all i, k, m", "grown", 1),
        computed="largest share {grown:.3f}; {norm[0]:.1f} and {norm[1]:.1f}, {norm[0]:.1f} and {norm[2]:.1f}",
        basis="spectral norms",
    ),
)
CHAPTER = Chapter(
    title="Chapter 4: fault-tolerant control by semi-Markov models",
    stages=(
        Stage("lifetimes", runs.early_figures, 0.1),
        Stage("conditions", _conditions, 4, CONDITIONS),
        Stage("simulations", runs.simulations, 4, runs.SIMULATIONS),
        Stage("gains of the corollaries", runs.recomputed, 7, runs.RECOMPUTED),
        Stage("gains that see r only", runs.gains_that_see_r, 0.3),
        Stage("a lost sensor", sensor_fault, 4, SENSOR_FAULT),
        Stage("disturbances that change, a Markov detection", other_faults, 7, OTHER_FAULTS),
        Stage("quadratic constraints", constraints, 4, CONSTRAINTS),
    ),
)
# fmt: on
