"""Synthesis and analysis of networked controllers as jump-linear systems.

::

    closed_loop -> mjls -> (second_moment, bounded_real) -> certificate
                     \\-> tracking (h2, hinf, mixed synthesis; ccl for comparison; bounds)
    rates -> semi_markov -> (stability, robust_feedback, delayed_hinf, fault_tolerant) -> certificate -> lmi.exact

Names are re-exported lazily: a process that keeps time imports `design.controllers` and pays for nothing else.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib import import_module

TYPE_CHECKING = False  # the import of typing takes time
if TYPE_CHECKING:
    from design.controllers.scheduled_gain import ScheduledGain as ScheduledGain
    from design.errors import DesignError as DesignError
    from design.errors import Infeasible as Infeasible
    from design.errors import NotStable as NotStable
    from design.identification import expected_errors as expected_errors
    from design.identification import square_wave as square_wave
    from design.jump_linear import MJLS as MJLS
    from design.jump_linear import h2_norm as h2_norm
    from design.jump_linear.bounded_real import hinf_norm as hinf_norm
    from design.jump_linear.certificate import Certificate as Certificate
    from design.jump_linear.certificate import certify_system as certify_system
    from design.lmi import prove as prove
    from design.networked_loop.affine_loop import LoopStructure as LoopStructure
    from design.networked_loop.certify import certify_loop as certify_loop
    from design.networked_loop.certify import lower_bounds as lower_bounds
    from design.networked_loop.closed_loop import loop_structure as loop_structure
    from design.networked_loop.prediction import Prediction as Prediction
    from design.networked_loop.prediction import predict_tracking as predict_tracking
    from design.networked_loop.uncertainty import robust_norms as robust_norms
    from design.networked_loop.uncertainty import uncertainty_margin as uncertainty_margin
    from design.processes.delay_chain import DelayChain as DelayChain
    from design.processes.further_rates import BathtubRate as BathtubRate
    from design.processes.further_rates import UserRate as UserRate
    from design.processes.rates import ScaledRate as ScaledRate
    from design.processes.semi_markov import FaultDetection as FaultDetection
    from design.processes.semi_markov import SemiMarkov as SemiMarkov
    from design.semi_markov_loop import DelayedJumpSystem as DelayedJumpSystem
    from design.semi_markov_loop import JumpSystem as JumpSystem
    from design.semi_markov_loop import NormBounded as NormBounded
    from design.semi_markov_loop import VertexUncertainty as VertexUncertainty
    from design.semi_markov_loop.certificate import JumpCertificate as JumpCertificate
    from design.semi_markov_loop.delayed_hinf import analyse_delayed as analyse_delayed
    from design.semi_markov_loop.delayed_hinf import delayed_hinf as delayed_hinf
    from design.semi_markov_loop.fault_tolerant import fault_tolerant_feedback as fault_tolerant_feedback
    from design.semi_markov_loop.fault_tolerant_analysis import Siqc as Siqc
    from design.semi_markov_loop.fault_tolerant_analysis import analyse_fault_tolerant as analyse_fault_tolerant
    from design.semi_markov_loop.robust_feedback import FeedbackRequest as FeedbackRequest
    from design.semi_markov_loop.robust_feedback import fastest_feedback as fastest_feedback
    from design.semi_markov_loop.robust_feedback import largest_uncertainty as largest_uncertainty
    from design.semi_markov_loop.stability import analyse as analyse
    from design.semi_markov_loop.stability import largest_decay as largest_decay
    from design.tracking import TrackingProblem as TrackingProblem
    from design.tracking.design_file import load_design as load_design
    from design.tracking.gain_cache import solve_cached as solve_cached
    from design.tracking.synthesis import Design as Design
    from design.tracking.synthesis import solve as solve


def exports(package: str, folder: str) -> tuple[Callable[[str], object], Callable[[], list[str]], list[str]]:
    """Return `__getattr__`, `__dir__` and `__all__` of a package; its `__init__.py` imports each public name for type checkers.

    Args:
        package: its name.
        folder: where it stands.
    """
    with open(f"{folder}/__init__.py", encoding="utf-8") as face:
        homes = {words[3]: words[1] for words in map(str.split, face) if words[0:1] + words[4:5] == ["from", "as"]}
    names = sorted(homes)

    def attribute(name: str) -> object:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(homes[name]), name)

    return attribute, lambda: sorted({*vars(sys.modules[package]), *names}), names


if not TYPE_CHECKING:
    __getattr__, __dir__, __all__ = exports(__name__, __path__[0])
