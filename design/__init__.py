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
    "DelayChain": "design.processes.delay_chain",
    "MJLS": "design.jump_linear.mjls",
    "Certificate": "design.jump_linear.certificate",
    "certify_loop": "design.networked_loop.certify",
    "certify_system": "design.jump_linear.certificate",
    "LoopStructure": "design.networked_loop.closed_loop",
    "loop_structure": "design.networked_loop.closed_loop",
    "h2_norm": "design.jump_linear.h2",
    "hinf_norm": "design.jump_linear.bounded_real",
    "TrackingProblem": "design.tracking.problem",
    "Design": "design.tracking.synthesis",
    "solve": "design.tracking.synthesis",
    "solve_cached": "design.tracking.cache",
    "load_design": "design.tracking.design_file",
    "lower_bounds": "design.networked_loop.lower_bounds",
    "predict_tracking": "design.networked_loop.prediction",
    "Prediction": "design.networked_loop.prediction",
    "robust_norms": "design.networked_loop.uncertainty",
    "uncertainty_margin": "design.networked_loop.uncertainty",
    "SemiMarkov": "design.processes.semi_markov",
    "FaultDetection": "design.processes.semi_markov",
    "JumpSystem": "design.semi_markov_loop.system",
    "DelayedJumpSystem": "design.semi_markov_loop.system",
    "NormBounded": "design.semi_markov_loop.system",
    "VertexUncertainty": "design.semi_markov_loop.system",
    "ScheduledGain": "design.controllers.scheduled_gain",
    "JumpCertificate": "design.semi_markov_loop.certificate",
    "analyse": "design.semi_markov_loop.stability",
    "largest_decay": "design.semi_markov_loop.stability",
    "robust_feedback": "design.semi_markov_loop.robust_feedback",
    "fastest_feedback": "design.semi_markov_loop.robust_feedback",
    "largest_uncertainty": "design.semi_markov_loop.robust_feedback",
    "FeedbackRequest": "design.semi_markov_loop.robust_feedback",
    "analyse_delayed": "design.semi_markov_loop.delayed_hinf",
    "delayed_hinf": "design.semi_markov_loop.delayed_hinf",
    "Siqc": "design.semi_markov_loop.fault_tolerant_analysis",
    "analyse_fault_tolerant": "design.semi_markov_loop.fault_tolerant_analysis",
    "fault_tolerant_feedback": "design.semi_markov_loop.fault_tolerant",
    "prove": "design.lmi.exact",
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
