"""Chapter 4, what its remarks add: other faults (4.1), a Markov detection (4.2), a quadratic constraint for the norm (4.4)."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from design.as_printed.examples import chapter4_system
from design.errors import Infeasible
from design.processes.semi_markov import FaultDetection
from design.semi_markov_loop.decay_rates import worst_growth
from design.semi_markov_loop.fault_tolerant import fault_tolerant_feedback
from design.semi_markov_loop.fault_tolerant_analysis import Siqc, analyse_fault_tolerant
from design.semi_markov_loop.system import JumpSystem
from hil.certify.jump_loop import process_of, system_of
from hil.compose.loop import compose
from hil.experiment import load_experiment
from hil.thesis.chapter import ReportProgress
from hil.thesis.chapter2.in_the_loop import markov_approximation
from hil.thesis.chapter4.simulations import faults
from hil.thesis.statements import Statement, above, below, exactly, says
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
    Statement(
        "Remark 4.1: a lost sensor is a mode of (4.1) that differs in what is measured alone, and gains exist for it",
        "can accommodate different types of fault scenarios",
        (
            exactly("largest change of A", "A", 0.0, 1e-12), exactly("largest change of B", "B", 0.0, 1e-12),
            exactly("largest change of E", "E", 0.0, 1e-12), above("largest change of what is measured", "lost", 0),
            says("(4.14), (4.23) with K_k S_i", "ours.verdict", "certified"),
            below("growth of E|x|^2 at the worst constant rates (1/s)", "growth", 0),
            says(f"{EXPERIMENT} at T = 1 ms", "loop", "certified"),
        ),
        computed="gamma {ours.gamma:.4f}, E|x|^2 grows at {growth:.3g}/s at most; the loop at T = 1 ms: {loop}",
        basis=f"the VTOL of Section 4.4 with sound actuators; in mode 2 the sensor of the pitch angle shows 0; gain norm <= "
        f"{GAIN_BOUND:g}, the controller sees r",
    ),
    Statement(
        "Remark 4.1: gains that know of the sensor fault attenuate better under it than gains that do not", "-",
        (below("gamma over that of gains for sound sensors", "ours.gamma", "unaware"),),
        computed="gamma {ours.gamma:.4f} against {unaware:.4f} ({unaware_word})", basis="the same gain bound, rates and fault",
    ),
)


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


def _change(matrices: npt.NDArray[np.float64] | None) -> float:
    return math.nan if matrices is None else float(np.abs(matrices[1] - matrices[0]).max())


OTHER_FAULTS = (
    Statement(
        "Remark 4.1: a fault of what disturbs is a mode of (4.1) that differs in E alone, and gains exist for it",
        "by tuning E(eta)",
        (
            exactly("largest change of A, B and C", "same", 0.0, 1e-12), above("largest change of E", "E", 0),
            says("(4.14), (4.23)", "rough.verdict", "certified"),
            below("growth of E|x|^2 at the worst constant rates (1/s)", "growth", 0),
            above("gamma over that without the fault", "rough.gamma", "calm.gamma"),
        ),
        computed="gamma {rough.gamma:.5f}, without the fault {calm.gamma:.5f}; E|x|^2 grows at {growth:.3g}/s at most",
        basis=f"the VTOL of Section 4.4 with sound actuators; in mode 2 E is {LARGER:g} times as large; gain norm <= "
        f"{GAIN_BOUND:g}, the controller sees r",
    ),
    Statement(
        "4.2: a Markov process may take the place of the detection in the design", "could be implemented",
        (says("its gains over the semi-Markov detection, (4.14), (4.23)", "over.verdict", "certified"),),
        computed="{over.verdict}: gamma {over.gamma:.4g}, of gains that know the rates {known.gamma:.4g}",
        basis=f"constant rates of r with the same mean sojourns; gain norm <= {GAIN_BOUND:g}. Both gains are descents to near "
        "their minima, so the difference is no claim",
    ),
)


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
    Statement(
        "Remark 4.4: Gamma_11 = I, Gamma_12 = 0, Gamma_22 = -gamma^2 I reduce (4.6) to the H-infinity performance (4.5)",
        "reduces to the standard H-infinity performance",
        (says(f"(4.6) at {AROUND[0]:g} gamma", "above", "certified"), says(f"(4.6) at {AROUND[1]:g} gamma", "below", "refused")),
        computed=f"gamma {{gamma:.5f}} by (4.5); (4.6): {{above}} at {AROUND[0]:g} of it, {{below}} at {AROUND[1]:g} of it",
        basis=f"our gains that see r, gain norm <= {GAIN_BOUND:g}; refused: dual matrices prove that no matrices exist",
    ),
    Statement(
        "(4.6) with Gamma_12 != 0: gains that meet it exist", "by tuning these matrices",
        (
            says("(4.23) for the gains found", "general.verdict", "certified"),
            above("margin of its inequalities, computed anew", "margin", 0),
        ),
        computed="{general.verdict}, margin {margin:.3g}, gain norm {norm:.3g}",
        basis=f"Gamma_11 = 1, Gamma_12 = [0.01 0], Gamma_22 = -0.001 I; with Gamma_22 = -{TIGHT:g} I the answer is '{{tight}}'",
    ),
)
