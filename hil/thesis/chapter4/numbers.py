"""Chapter 4: fault-tolerant control by semi-Markov models; the VTOL example of Section 4.4.

What the conditions of the corollaries say of the printed gains (4.30), (4.31); and gains of the corollaries themselves beside
them, both under one bound.
"""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import numpy.typing as npt

from design.as_printed.chapters_2_to_4 import detection_section, free_gains
from design.as_printed.examples import (
    CHAPTER4_DETECTION_BOUNDARY_S,
    CHAPTER4_FAILURE_BOUNDARY_S,
    chapter4_gain,
    chapter4_partitioned_gain,
    chapter4_rate_knots,
    chapter4_seen_gain,
    chapter4_system,
)
from design.processes.partitions import Partition
from design.processes.rates import PiecewiseLinearRate
from design.processes.semi_markov import FaultDetection, SemiMarkov
from design.semi_markov_loop.certificate import JumpCertificate
from design.semi_markov_loop.decay_rates import mean_square_abscissa
from design.semi_markov_loop.fault_tolerant_analysis import analyse_fault_tolerant
from design.semi_markov_loop.system import JumpSystem
from hil.thesis.chapter import Chapter, ReportProgress, Stage
from hil.thesis.chapter4.further import CONSTRAINTS, OTHER_FAULTS, SENSOR_FAULT, constraints, other_faults, sensor_fault
from hil.thesis.chapter4.simulations import (
    ASSUMED,
    RUNS,
    SIMULATIONS,
    early_figures,
    faults,
    gains_that_see_r,
    known_fault,
    our_gains,
    simulate,
    simulations,
)
from hil.thesis.statements import ERRORS, Statement, above, below, exactly, number_of, says

Array = npt.NDArray[np.float64]
GAMMA = 1.5
BOUNDS = (5.0, 10.0, 50.0)
"""Bounds on the norm of the gains; none is printed, and the largest norms of (4.30) and (4.31) are 51.6 and 34.9."""

FAILURE, DETECTIONS = chapter4_rate_knots()
ONE: Partition = ((0.0,),) * 2
ETA: Partition = ((0.0, CHAPTER4_FAILURE_BOUNDARY_S),) * 2
DETECTION: Partition = ((0.0, CHAPTER4_DETECTION_BOUNDARY_S),) * 2


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
        "by_r_parts": by_r_parts, "away": _largest(middle - 0.5 * (low + high)),
        "away_s": _largest(middle - 2.0 / (1.0 / low + 1.0 / high)), "smallest": float(middle.min()),
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


def recomputed(report_progress: ReportProgress) -> dict[str, Any]:
    """Gains, levels and runs of both corollaries, for each bound of the gains."""
    values: dict[str, list[Any]] = {name: [] for name in ("single", "parts", "off", "levels", "less", "ratios", "share")}
    for n, bound in enumerate(BOUNDS):
        report_progress(f"gain norm <= {bound:g}", n, len(BOUNDS))
        single, parts = _sections(bound, GAMMA)
        gains = [_stacked([single]), _stacked(parts)]
        values["single"].append(single)
        values["parts"].append(parts)
        values["off"].append([_largest(gains[0][:, :, 0] - chapter4_gain()), _largest(gains[1] - chapter4_partitioned_gain())])
        least = _sections(bound, None)
        values["levels"].append([number_of(least[0].gamma), float(np.max([number_of(part.gamma) for part in least[1]]))])
        values["share"].append(values["levels"][-1][0] / values["levels"][-1][1])
        ratios = [simulate(known_fault(gain)).ratio for gain in gains]
        less = ratios[1] / ratios[0] - 1.0
        values["less"].append(float(less.mean()) + ERRORS * float(less.std()) / RUNS**0.5)
        values["ratios"].append([float(each.mean()) for each in ratios])
    return values | {"size": [float(np.abs(each).max()) for each in (chapter4_gain(), chapter4_partitioned_gain())]}


def _sections(bound: float, gamma: float | None) -> tuple[JumpCertificate, list[JumpCertificate]]:
    system, process = chapter4_system(), faults()
    single = detection_section(system, process, ONE, ONE, 0, None, gain_bound=bound, gamma=gamma)
    return single, [detection_section(system, process, ETA, DETECTION, m, None, gain_bound=bound, gamma=gamma) for m in (0, 1)]


def _stacked(sections: list[JumpCertificate]) -> Array:
    """K_ik,m, (2, 2, sections, 2, 4)."""
    gains = np.stack([free_gains(section, ("0,0", "0,1", "1,0", "1,1")) for section in sections], axis=1)
    return np.asarray(gains.reshape(2, 2, len(sections), 2, 4))


def _largest(difference: Array) -> float:
    return float(np.abs(difference).max())


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
            says("sound, two clocks", "sound.verdict", "certified"), below("smallest gamma of that", "sound.gamma", 1.5),
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
        "sections meet at the mid-points of the rate bounds (4.28)", "0.5 between 0.333 and 1, and five others",
        (exactly("largest distance from a mid-point (1/s)", "away", 0, 0.5e-3, "smallest"),),
        (exactly("largest distance from the rate of the mean of both sojourn times (1/s)", "away_s", 0, 0.5e-3, "smallest"),),
        basis="they are mid-points of the mean sojourn times, to the printed digits; the boundary in h is not printed",
    ),
    Statement(
        "the partition needs no larger gains: |K_11| > |K_11,1|, |K_11| > |K_11,2|", "Remark 4.6",
        (below("largest |K_ik,m| over |K_ik|, all i, k, m", "grown", 1),),
        computed="largest share {grown:.3f}; {norm[0]:.1f} and {norm[1]:.1f}, {norm[0]:.1f} and {norm[2]:.1f}",
        basis="spectral norms",
    ),
)
RECOMPUTED = (
    *(
        Statement(
            f"{label}: the gains of {corollary} at gamma = 1.5", f"{count} matrices of 2 x 4",
            (
                *(says(f"{equation}{which}, gains free", f"{name}[2]{at}.verdict", "certified") for which, at in sections),
                exactly("largest difference of the gains", f"off[2][{n}]", 0, 0.5e-4, f"size[{n}]"),
            ),
            basis=f"gain norm <= {BOUNDS[2]:g}; half a unit of the last printed digit. An inequality alone, with no objective "
            "and no bound printed: the printed gains fulfil it too (above)",
        )
        for n, (label, corollary, equation, count, name, sections) in enumerate((
            ("(4.30)", "Corollary 4.2", "(4.26)", "four", "single", (("", ""),)),
            ("(4.31)", "Corollary 4.3", "(4.27)", "eight", "parts", ((", section 1", "[0]"), (", section 2", "[1]"))),
        ))
    ),
    Statement(
        "Remark 4.5: two sections (Corollary 4.3) are less conservative than one (Corollary 4.2), as printed",
        "extra constraints without sections",
        tuple(
            above(f"smallest gamma of Corollary 4.2 over that of Corollary 4.3, gain norm <= {bound:g}", f"share[{n}]", 1.01)
            for n, bound in enumerate(BOUNDS)
        ),
        computed="; ".join(f"{{levels[{n}][0]:.3g}} and {{levels[{n}][1]:.3g}}" for n in range(len(BOUNDS))), readings=True,
        basis="Corollary 4.3 tests two of four section pairs and is not sound (above): part of this may be what it leaves out",
    ),
    Statement(
        "Remark 4.6: the partition reduces ||y||, with gains of both corollaries themselves under one bound", "reduced",
        tuple(
            below(f"mean change of ||y|| plus 4 standard errors, gain norm <= {bound:g}", f"less[{n}]", -0.001)
            for n, bound in enumerate(BOUNDS)
        ),
        computed="||y||/||w|| " + "; ".join(f"{{ratios[{n}][0]:.4f}} and {{ratios[{n}][1]:.4f}}" for n in range(len(BOUNDS))),
        readings=True,
        basis=f"gains at gamma = 1.5, {RUNS} runs of 3 s, fault known, noise held 0.01 s; by a thousandth",
    ),
)
CHAPTER = Chapter(
    title="Chapter 4: fault-tolerant control by semi-Markov models",
    stages=(
        Stage("lifetimes", early_figures, 0.1),
        Stage("conditions", _conditions, 4, CONDITIONS),
        Stage("simulations", simulations, 4, SIMULATIONS),
        Stage("gains of the corollaries", recomputed, 7, RECOMPUTED),
        Stage("gains that see r only", gains_that_see_r, 0.3),
        Stage("a lost sensor", sensor_fault, 4, SENSOR_FAULT),
        Stage("disturbances that change, a Markov detection", other_faults, 7, OTHER_FAULTS),
        Stage("quadratic constraints", constraints, 4, CONSTRAINTS),
    ),
)
