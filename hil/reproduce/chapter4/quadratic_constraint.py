"""(4.6), Remark 4.4: a stochastic integral quadratic constraint in the place of the H-infinity norm."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from design.as_printed.examples import chapter4_process, chapter4_system
from design.errors import Infeasible
from design.semi_markov_loop.fault_tolerant import fault_tolerant_feedback
from design.semi_markov_loop.fault_tolerant_analysis import Siqc, analyse_fault_tolerant
from hil.reproduce.chapter import ReportProgress
from hil.reproduce.statements import Statement, above, says

GAIN_BOUND = 2.0
AROUND = (1.02, 0.9)
"""Levels over the smallest gamma of some gains: above it, and below."""
GENERAL = (np.array([[1.0]]), np.array([[0.01, 0.0]]), -1e-3 * np.eye(2))
TIGHT = 1e-5
"""-Gamma_22 that no gains within the bound meet."""


def constraints(report_progress: ReportProgress) -> dict[str, Any]:
    """Levels of gains by both conditions, and gains for a general Gamma."""
    system, process = chapter4_system(), chapter4_process(failure_restarts_detection_clock=False)
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
