"""What Chapter 2 improves on: gains of the Markov process that has the place of the semi-Markov one (Sections 2.5, 8.1)."""

from __future__ import annotations

from typing import Any

from design.as_printed.examples import chapter2_process, chapter2_system
from design.semi_markov_loop.robust_feedback import FeedbackRequest, fastest_feedback
from design.semi_markov_loop.second_moments import second_moment_decay
from hil.reproduce.chapter import ReportProgress
from hil.reproduce.markov_approximation import markov_approximation, mean_sojourns
from hil.reproduce.statements import Statement, above

BOUNDS = (5.0, 10.0, 30.0)
"""Bounds on the norm of the gains; those of [1, 2] have the norm 4.4, (2.27) has 26."""


def markov(report_progress: ReportProgress) -> dict[str, Any]:
    """Decay of the second moments over the rates (2.26), of gains for these rates and for constant ones."""
    process, nominal = chapter2_process(), chapter2_system("none")
    asked = {"markov": (markov_approximation(process), 1), "semi": (process, 2)}
    decay: dict[str, list[float]] = {name: [] for name in asked}
    for n, bound in enumerate(BOUNDS):
        report_progress(f"gain norm <= {bound:g}", n, len(BOUNDS))
        for name, (rates, sections) in asked.items():
            gain = fastest_feedback(nominal, FeedbackRequest(process=rates, gain_bound=bound, sections=sections)).gain
            assert gain is not None
            decay[name].append(second_moment_decay(nominal, gain, process))
    return decay | {
        "ratio": [ours / theirs for ours, theirs in zip(decay["semi"], decay["markov"], strict=True)],
        "stay": mean_sojourns(process)[0],
    }  # fmt: skip


MARKOV = (
    Statement(
        "8.1: control improves on that by a Markov approximation", "improved",
        tuple(
            above(f"decay rate of E|x|^2 over that with gains of the approximation, gain norm <= {bound:g}", f"ratio[{n}]", 1.0)
            for n, bound in enumerate(BOUNDS)
        ),
        computed="{semi[0]:.3f}/s and {markov[0]:.3f}/s; {semi[1]:.3f}/s and {markov[1]:.3f}/s; {semi[2]:.3f}/s and "
        "{markov[2]:.3f}/s",
        basis="the nominal example, exact second moments over the rates (2.26). Gains of largest certified decay: two sections, "
        "linear in h; and one gain a mode for constant rates with the same mean sojourn of {stay:.4f} s",
    ),
)
