"""Synthesis and analysis of networked controllers as jump-linear systems.

::

    closed_loop -> mjls -> (second_moment, h2, bounded_real) -> certificate
                     \\-> tracking (h2, hinf, mixed synthesis; ccl for comparison; bounds)
    rates -> semi_markov -> (smjls_analysis, robust_feedback, delayed_hinf, fault_tolerant) -> jump_certificate -> exact_proof

Names are re-exported lazily: a process that keeps time imports `design.controllers` and pays for nothing else.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from design.controllers.scheduled_gain import ScheduledGain as ScheduledGain
    from design.errors import DesignError as DesignError
    from design.errors import Infeasible as Infeasible
    from design.errors import NotStable as NotStable
    from design.identification.excitation import expected_errors as expected_errors
    from design.identification.excitation import square_wave as square_wave
    from design.jump_linear.bounded_real import hinf_norm as hinf_norm
    from design.jump_linear.certificate import Certificate as Certificate
    from design.jump_linear.certificate import certify_system as certify_system
    from design.jump_linear.h2 import h2_norm as h2_norm
    from design.jump_linear.mjls import MJLS as MJLS
    from design.lmi.exact import prove as prove
    from design.networked_loop.certify import certify_loop as certify_loop
    from design.networked_loop.closed_loop import LoopStructure as LoopStructure
    from design.networked_loop.closed_loop import loop_structure as loop_structure
    from design.networked_loop.lower_bounds import lower_bounds as lower_bounds
    from design.networked_loop.prediction import Prediction as Prediction
    from design.networked_loop.prediction import predict_tracking as predict_tracking
    from design.networked_loop.uncertainty import robust_norms as robust_norms
    from design.networked_loop.uncertainty import uncertainty_margin as uncertainty_margin
    from design.processes.delay_chain import DelayChain as DelayChain
    from design.processes.lifetimes import BathtubRate as BathtubRate
    from design.processes.rates import ScaledRate as ScaledRate
    from design.processes.semi_markov import FaultDetection as FaultDetection
    from design.processes.semi_markov import SemiMarkov as SemiMarkov
    from design.processes.user_rate import UserRate as UserRate
    from design.semi_markov_loop.certificate import JumpCertificate as JumpCertificate
    from design.semi_markov_loop.delayed_hinf import analyse_delayed as analyse_delayed
    from design.semi_markov_loop.delayed_hinf import delayed_hinf as delayed_hinf
    from design.semi_markov_loop.fault_tolerant import fault_tolerant_feedback as fault_tolerant_feedback
    from design.semi_markov_loop.fault_tolerant_analysis import Siqc as Siqc
    from design.semi_markov_loop.fault_tolerant_analysis import analyse_fault_tolerant as analyse_fault_tolerant
    from design.semi_markov_loop.robust_feedback import FeedbackRequest as FeedbackRequest
    from design.semi_markov_loop.robust_feedback import fastest_feedback as fastest_feedback
    from design.semi_markov_loop.robust_feedback import largest_uncertainty as largest_uncertainty
    from design.semi_markov_loop.robust_feedback import robust_feedback as robust_feedback
    from design.semi_markov_loop.stability import analyse as analyse
    from design.semi_markov_loop.stability import largest_decay as largest_decay
    from design.semi_markov_loop.system import DelayedJumpSystem as DelayedJumpSystem
    from design.semi_markov_loop.system import JumpSystem as JumpSystem
    from design.semi_markov_loop.system import NormBounded as NormBounded
    from design.semi_markov_loop.system import VertexUncertainty as VertexUncertainty
    from design.tracking.cache import solve_cached as solve_cached
    from design.tracking.design_file import load_design as load_design
    from design.tracking.problem import TrackingProblem as TrackingProblem
    from design.tracking.synthesis import Design as Design
    from design.tracking.synthesis import solve as solve

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
    "BathtubRate": "design.processes.lifetimes",
    "ScaledRate": "design.processes.rates",
    "UserRate": "design.processes.user_rate",
    "expected_errors": "design.identification.excitation",
    "square_wave": "design.identification.excitation",
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


if not TYPE_CHECKING:  # a type checker shall tell a name that is not there

    def __getattr__(name: str) -> object:
        try:
            module = _EXPORTS[name]
        except KeyError:
            raise AttributeError(f"module 'design' has no attribute {name!r}") from None
        return getattr(import_module(module), name)


def __dir__() -> list[str]:
    return __all__
