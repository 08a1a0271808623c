"""Synthesis and analysis of networked controllers as jump-linear systems.

    closed_loop -> mjls -> (second_moment, h2, bounded_real) -> certificate
                     \\-> tracking (h2, hinf, mixed synthesis; ccl for comparison; bounds)
    rates -> semi_markov -> (smjls_analysis, robust_feedback, delayed_hinf, fault_tolerant) -> jump_certificate -> exact_proof

Names are re-exported lazily: a process that keeps time imports `design.controllers` and pays for nothing else.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

_EXPORTS = {
    "DesignError": "design.errors",
    "NotStable": "design.errors",
    "Infeasible": "design.errors",
    "DelayChain": "design.delay_chain",
    "MJLS": "design.mjls",
    "Certificate": "design.certificate",
    "certify_loop": "design.certificate",
    "certify_system": "design.certificate",
    "LoopStructure": "design.closed_loop",
    "loop_structure": "design.closed_loop",
    "h2_norm": "design.h2",
    "hinf_norm": "design.bounded_real",
    "TrackingProblem": "design.problem",
    "Design": "design.tracking",
    "solve": "design.tracking",
    "solve_cached": "design.cache",
    "load_design": "design.design_file",
    "lower_bounds": "design.bounds",
    "SemiMarkovDelays": "design.semi_markov_delays",
    "predict_tracking": "design.prediction",
    "Prediction": "design.prediction",
    "robust_norms": "design.uncertainty",
    "uncertainty_margin": "design.uncertainty",
    "SemiMarkov": "design.semi_markov",
    "FaultDetection": "design.semi_markov",
    "JumpSystem": "design.smjls",
    "DelayedJumpSystem": "design.smjls",
    "NormBounded": "design.smjls",
    "VertexUncertainty": "design.smjls",
    "ScheduledGain": "design.scheduled_gain",
    "JumpCertificate": "design.jump_certificate",
    "analyse": "design.smjls_analysis",
    "largest_decay": "design.smjls_analysis",
    "robust_feedback": "design.robust_feedback",
    "fastest_feedback": "design.robust_feedback",
    "largest_uncertainty": "design.robust_feedback",
    "FeedbackRequest": "design.robust_feedback",
    "analyse_delayed": "design.delayed_hinf",
    "delayed_hinf": "design.delayed_hinf",
    "Siqc": "design.fault_tolerant_loop",
    "analyse_fault_tolerant": "design.fault_tolerant_loop",
    "fault_tolerant_feedback": "design.fault_tolerant",
    "prove": "design.exact_proof",
}

__all__ = sorted(_EXPORTS)  # noqa: PLE0605


def __getattr__(name: str) -> Any:
    try:
        module = _EXPORTS[name]
    except KeyError:
        raise AttributeError(f"module 'design' has no attribute {name!r}") from None
    return getattr(import_module(module), name)


def __dir__() -> list[str]:
    return __all__
