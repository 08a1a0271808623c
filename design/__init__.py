"""Synthesis and analysis of networked controllers as jump-linear systems.

::

    closed_loop -> mjls -> (second_moment, h2, bounded_real) -> certificate
                     \\-> tracking (h2, hinf, mixed synthesis; ccl for comparison; bounds)
    rates -> semi_markov -> (smjls_analysis, robust_feedback, delayed_hinf, fault_tolerant) -> jump_certificate -> exact_proof

Names are re-exported lazily: a process that keeps time imports `design.controllers` and pays for nothing else.
"""

from __future__ import annotations

from importlib import import_module
from typing import Final

_NAMES: Final = {
    "design.controllers.scheduled_gain": "ScheduledGain",
    "design.errors": "DesignError Infeasible NotStable",
    "design.identification.axis": "expected_errors square_wave",
    "design.jump_linear.bounded_real": "hinf_norm",
    "design.jump_linear.certificate": "Certificate certify_system",
    "design.jump_linear.mjls": "MJLS h2_norm",
    "design.lmi.exact": "prove",
    "design.networked_loop.certify": "certify_loop lower_bounds",
    "design.networked_loop.affine_loop": "LoopStructure",
    "design.networked_loop.closed_loop": "loop_structure",
    "design.networked_loop.prediction": "Prediction predict_tracking",
    "design.networked_loop.uncertainty": "robust_norms uncertainty_margin",
    "design.processes.delay_chain": "DelayChain",
    "design.processes.further_rates": "BathtubRate UserRate",
    "design.processes.rates": "ScaledRate",
    "design.processes.semi_markov": "FaultDetection SemiMarkov",
    "design.semi_markov_loop.certificate": "JumpCertificate",
    "design.semi_markov_loop.delayed_hinf": "analyse_delayed delayed_hinf",
    "design.semi_markov_loop.fault_tolerant": "fault_tolerant_feedback",
    "design.semi_markov_loop.fault_tolerant_analysis": "Siqc analyse_fault_tolerant",
    "design.semi_markov_loop.robust_feedback": "FeedbackRequest fastest_feedback largest_uncertainty robust_feedback",
    "design.semi_markov_loop.stability": "analyse largest_decay",
    "design.semi_markov_loop.system": "DelayedJumpSystem JumpSystem NormBounded VertexUncertainty",
    "design.tracking.design_file": "load_design",
    "design.tracking.gain_cache": "solve_cached",
    "design.tracking.problem": "TrackingProblem",
    "design.tracking.synthesis": "Design solve",
}
"""Module to the public names that it brings; `__init__.pyi` has the same ones for type checkers."""

_HOMES = {name: module for module, names in _NAMES.items() for name in names.split()}

__all__ = sorted(_HOMES)  # noqa: PLE0605


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
