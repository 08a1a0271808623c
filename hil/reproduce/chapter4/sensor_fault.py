"""Remark 4.1: a sensor that is lost, beside the actuator that Section 4.4 lets fail."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from design.processes.semi_markov import FaultDetection
from design.semi_markov_loop.fault_tolerant import fault_tolerant_feedback
from design.semi_markov_loop.fault_tolerant_analysis import analyse_fault_tolerant
from design.semi_markov_loop.period_moments import worst_growth
from design.semi_markov_loop.system import JumpSystem
from hil.certify.jump_loop import process_of, system_of
from hil.compose.loop import compose
from hil.experiment import load_experiment
from hil.reproduce.chapter import ReportProgress
from hil.reproduce.statements import Statement, above, below, exactly, says
from plants.vtol_fault import FaultyVTOL

EXPERIMENT = "vtol-sensor-fault"
GAIN_BOUND = 2.0


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
        "A": float(np.abs(system.a[1] - system.a[0]).max()), "B": float(np.abs(system.b[1] - system.b[0]).max()),
        "lost": float(np.abs(system.shown(1) - system.shown(0)).max()), "ours": ours, "gamma": ours.gamma or math.nan,
        "unaware": unaware.gamma if unaware.gamma is not None else math.inf, "unaware_word": unaware.verdict,
        "loop": "none" if verdict is None else verdict.state, "growth": math.nan if growth is None else growth[0],
    }  # fmt: skip


SENSOR_FAULT = (
    Statement(
        "Remark 4.1: a lost sensor is a mode of (4.1) that differs in what is measured alone, and gains exist for it",
        "can accommodate different types of fault scenarios",
        (
            exactly("largest change of A", "A", 0.0, 1e-12), exactly("largest change of B", "B", 0.0, 1e-12),
            above("largest change of what is measured", "lost", 0),
            says("(4.14), (4.23) with K_k S_i", "ours.verdict", "certified"),
            below("growth of E|x|^2 at the worst constant rates (1/s)", "growth", 0),
            says(f"{EXPERIMENT} at T = 1 ms", "loop", "certified"),
        ),
        computed="gamma {gamma:.4f}, E|x|^2 grows at {growth:.3g}/s at most; the loop at T = 1 ms: {loop}",
        basis=f"the VTOL of Section 4.4 with sound actuators; in mode 2 the sensor of the pitch angle shows 0; gain norm <= "
        f"{GAIN_BOUND:g}, the controller sees r",
    ),
    Statement(
        "Remark 4.1: gains that know of the sensor fault attenuate better under it than gains that do not", "-",
        (below("gamma over that of gains for sound sensors", "gamma", "unaware"),),
        computed="gamma {gamma:.4f} against {unaware:.4f} ({unaware_word})", basis="the same gain bound, rates and fault",
    ),
)
