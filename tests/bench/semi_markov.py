"""The syntheses that Chapters 2 to 4 are measured by: what each must reach, and within what time.

``python -m tests.bench design`` runs them.
A case returns the number reached with the certificate that proves it; nothing else counts.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, NamedTuple

from design.semi_markov_loop.certificate import JumpCertificate

LIMIT_S = 10.0
"""Time that each synthesis may take on two cores (s)."""


class BenchCase(NamedTuple):
    """One synthesis: its name, the number it must reach (``sense`` says which side) and how to run it."""

    name: str
    quantity: str
    required: float
    sense: Literal[">=", "<="]
    run: Callable[[], tuple[float, JumpCertificate]]

    def met(self, reached: float) -> bool:
        """Whether a number fulfils the requirement."""
        return reached >= self.required if self.sense == ">=" else reached <= self.required


def bench_cases() -> tuple[BenchCase, ...]:
    """The cases, cheap to list; each ``run`` solves, certifies and returns (number, certificate)."""
    return (
        BenchCase("ch2 robust feedback, 2 sections, |K| <= 100", "uncertainty scale", 0.72, ">=", lambda: _chapter2(2)),
        BenchCase("ch2 robust feedback, 8 sections, |K| <= 100", "uncertainty scale", 1.14, ">=", lambda: _chapter2(8)),
        BenchCase("ch3 delayed H-infinity, |K| <= 5", "gamma", 0.0200, "<=", lambda: _chapter3(5.0)),
        BenchCase("ch3 delayed H-infinity, |K| <= 1.5", "gamma", 0.0680, "<=", lambda: _chapter3(1.5)),
        BenchCase("ch4 fault-tolerant, sees r, |K| <= 2", "gamma", 0.0060, "<=", _chapter4),
    )


def _chapter2(sections: int) -> tuple[float, JumpCertificate]:
    from design.as_printed import chapter2_process, chapter2_system
    from design.semi_markov_loop.robust_feedback import FeedbackRequest, largest_uncertainty

    request = FeedbackRequest(process=chapter2_process(), gain_bound=100.0, sections=sections)
    return largest_uncertainty(chapter2_system("vertices"), request)


def _chapter3(gain_bound: float) -> tuple[float, JumpCertificate]:
    from design.as_printed import CHAPTER3_BOUNDARY_S, chapter3_process, chapter3_system
    from design.semi_markov_loop.delayed_hinf import delayed_hinf

    sections = ((0.0, CHAPTER3_BOUNDARY_S),) * 3
    certificate = delayed_hinf(chapter3_system(), chapter3_process(), gain_bound=gain_bound, sections=sections)
    return _gamma(certificate), certificate


def _chapter4() -> tuple[float, JumpCertificate]:
    from design.as_printed import chapter4_process, chapter4_system
    from design.semi_markov_loop.fault_tolerant import fault_tolerant_feedback

    process = chapter4_process(failure_restarts_detection_clock=False)
    certificate = fault_tolerant_feedback(chapter4_system(), process, gain_bound=2.0)
    return _gamma(certificate), certificate


def _gamma(certificate: JumpCertificate) -> float:
    return float("inf") if certificate.gamma is None else certificate.gamma
