"""For which parts and forms of the conditions the example (2.25)-(2.28) has gains, and what the gains (2.27) fulfil.

And what the chapter improves on: gains of the Markov process that has the place of the semi-Markov one, with constant rates and
the same mean sojourns (Sections 1.1, 2.5, 4.2, 8.1).
"""

from __future__ import annotations

import math
import time
from typing import Any, Literal, get_args

import numpy as np

from design.as_printed import CHAPTER2_BOUNDARY_S, chapter2_gain, chapter2_process, chapter2_system
from design.as_printed.chapters_2_to_4 import PrintedRequest, printed_stability
from design.lmi import decide, prove_certificate
from design.lmi.program import LmiSolution
from design.processes.rates import constant_rate
from design.processes.semi_markov import SemiMarkov
from design.semi_markov_loop import JumpSystem
from design.semi_markov_loop.certificate import JumpCertificate
from design.semi_markov_loop.robust_feedback import FeedbackRequest, fastest_feedback, feedback_program
from design.semi_markov_loop.second_moments import second_moment_decay
from design.semi_markov_loop.stability import analyse, largest_decay
from hil.thesis import ReportProgress
from hil.thesis.statements import above, exactly, not_judged, says, statement

SECTIONS = (1, 2, 4, 8)
Form = Literal["printed", "pwc", "pwl"]
FORMS: tuple[Form, ...] = get_args(Form)


def verdict_of(certificate: JumpCertificate) -> str:
    """Return the verdict of a certificate, with its margin where it has one."""
    margin = "" if certificate.margin is None else f", margin {certificate.margin:.3g}"
    return f"{certificate.verdict}{margin}"


def _gains_exist(system: JumpSystem, sections: int, form: Form) -> LmiSolution:
    """The synthesis problem of Corollary 2.2 with |K| <= 100: solved, or refused by dual matrices."""
    process = chapter2_process()
    asked = FeedbackRequest(process=process, gain_bound=100.0, sections=sections, method="pwl" if form == "pwl" else "pwc")
    for condition in (asked.condition, 0.1 * asked.condition):  # a smaller box is easier to prove empty
        if form == "printed":
            program = feedback_program(system, process, asked.nodes, "pwc", 100.0, 0.0, condition, sound=False)
        else:
            program = feedback_program(system, process, asked.nodes, asked.method, 100.0, 0.0, condition)
        found = program.solve()
        if found.holds or found.refused:
            return found
    return decide(program)


def _word(found: LmiSolution) -> str:
    return "feasible" if found.holds else "refused" if found.refused else "undecided"


def feasibility(report_progress: ReportProgress) -> dict[str, Any]:
    """What Section 2.5 says of the conditions for the example."""
    process, printed = chapter2_process(), chapter2_system("printed")
    ours = FeedbackRequest(process=process, gain_bound=30.0, sections=1, method="pwc").solve(printed)
    assert ours.gain is not None
    proof = prove_certificate(ours)
    published = printed_stability(printed, chapter2_gain(), process)
    constant = analyse(printed, chapter2_gain(), process, method="pwc", condition=1e3)
    linear = largest_decay(printed, chapter2_gain(), process, nodes=((0.0, CHAPTER2_BOUNDARY_S, 4.6),) * 2)
    matched = _gains_exist(chapter2_system("matched"), 1, "pwc")
    forms = {
        name: [_gains_exist(chapter2_system("vertices").scaled(scale), count, form) for count in (2, 4)]
        for name, form, scale in SCALED
    }
    begun = time.process_time()
    asked = PrintedRequest(process=process, gain_bound=100.0, sections=((0.0, CHAPTER2_BOUNDARY_S),) * 2)
    gains = asked.judge(printed, asked.find(printed, 0.0), 0.0)
    return {
        "seconds": time.process_time() - begun, "gains": gains, "published": published, "linear": linear,
        **_beside_printed(gains),
        "single": _word(_gains_exist(printed, 1, "pwc")), "proved": proof.inequalities if proof.proved else 0,
        "pivot": float(proof.smallest_pivot), "sections": ours.gain.starts_s.shape[1],
        "matched": _word(matched), "no_gains": matched.explain(),
        "K": ", ".join(np.array2string(g[0, 0], precision=2) for g in ours.gain.gain),
        "ours": FeedbackRequest(process=process, gain_bound=100.0, sections=8).solve(chapter2_system("vertices")).verdict,
        "printed_form": verdict_of(published), "constant": verdict_of(constant),
        "forms": {name: [_word(each) for each in found] for name, found in forms.items()},
        "why": {name: found[0].explain() for name, found in forms.items()},
    }  # fmt: skip


def _beside_printed(found: JumpCertificate) -> dict[str, Any]:
    """How far gains of Corollary 2.2 are from (2.27)."""
    printed, gain = chapter2_gain().gain, np.full(4, math.nan) if found.gain is None else found.gain.gain
    words = ", ".join(np.array2string(K[0], precision=4) for K in gain.reshape(-1, 1, 2)) if gain.ndim == 4 else "none"
    off = float(np.abs(gain - printed).max()) if gain.shape == printed.shape else math.nan
    return {"off": off, "size": float(np.abs(printed).max()), "found": words}


SCALED: tuple[tuple[str, Form, float], ...] = (
    ("the printed form", "printed", 0.58),
    ("the sound form, linear in h", "pwl", 0.9),
)
"""For certain systems M = 4 has a solution and M = 2 has none: the example at another scale of its uncertainty."""


# fmt: off
FEASIBILITY = (
    statement(
        "Theorem 2.4 (M = 1) for (2.25), rates in [0.1, 4.6]", "not feasible", says("gains for M = 1", "single", "refused"),
        witness=(
            above("inequalities proved without rounding", "proved", 0), above("smallest pivot of LDL'", "pivot", 0),
            exactly("sections of the gains that are proved", "sections", 1),
        ),
        computed="feasible, K1, K2 = {K}",
        basis="exact rational certificate: {proved} inequalities, LDL' pivots >= {pivot:.3g}",
    ),
    statement(
        "the same with the F that give the printed A_i(t)", "not feasible", says("gains for M = 1", "matched", "refused"),
        computed="{no_gains}; ours with 8 sections, linear in h: {ours}",
        basis="F_A1 = [0 .1; 0 0], F_A2 = [0 0; 0 .7]; (2.25) prints other F",
    ),
    statement(
        "gains (2.27) fulfil the conditions of Corollary 2.2", "feasible, h_1 = 0.8326 s",
        says("printed form", "published.verdict", "certified"),
        computed="printed form {printed_form}; sound, constant per section: {constant}",
        basis="F of (2.25); the printed form proves nothing (below)",
    ),
    statement(
        "gains (2.27) stabilise under all uncertainty of (2.25)", "stochastically stable",
        says("linear in h", "linear.verdict", "certified"), above("certified decay of E|x|^2 (1/s)", "linear.decay_rate", 0),
        basis="Lyapunov matrix linear in h, nodes 0, 0.8326, 4.6 s",
    ),
    *(
        statement(
            f"M = 4 yields a feasible solution, while M = 2 does not, for certain systems, by {name}", "Section 2.5",
            says("M = 2", f"forms[{name}][0]", "refused"), says("M = 4", f"forms[{name}][1]", "feasible"),
            basis=f"A_i(t), B_2(t) as printed with {scale:g} of the uncertainty, equal probability (2.22), |K| <= 100; M = 2: "
            f"{{why[{name}]}}" + ("; the printed form proves no stability (below)" if form == "printed" else ""),
        )
        for name, form, scale in SCALED
    ),
    statement(
        "computation time of the gains of Corollary 2.2, M = 2", "0.0749 s",
        not_judged("CPU time (s)", "seconds", "the PC of 2012 is not at hand"), says("gains", "gains.verdict", "certified"),
        basis="printed form, assembly and check included",
    ),
    statement(
        "(2.27): the gains of Corollary 2.2, M = 2", "K(1,1), K(1,2), K(2,1), K(2,2)",
        exactly("largest difference", "off", 0, 0.5e-4, "size"), computed="{found}",
        basis="printed form, |K| <= 100; half a unit of the last printed digit. An inequality alone, with no objective and no "
        "bound printed: any gains that fulfil it are gains of Corollary 2.2, (2.27) too (above)",
    ),
)
# fmt: on

POINTS = 100_000
"""Of the sojourn's distribution, over which it is averaged."""


def mean_sojourns(process: SemiMarkov) -> list[float]:
    """Return the mean sojourn of every mode, s."""
    shares = (np.arange(POINTS) + 0.5) / POINTS
    return [float(process.sojourn(mode, -np.log1p(-shares)).mean()) for mode in range(process.modes)]


def markov_approximation(process: SemiMarkov) -> SemiMarkov:
    """Return the Markov process of two modes with the mean sojourns of another.

    Raises:
        ValueError: it has not two modes, between which a rate alone does not say where a jump leads.
    """
    if process.modes != 2:
        raise ValueError(f"process: {process.modes} modes, expected 2")
    out, back = (constant_rate(1.0 / mean) for mean in mean_sojourns(process))
    return SemiMarkov(rates=((None, out), (back, None)))


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
    return decay | {"stay": mean_sojourns(process)[0]}


MARKOV = (
    statement(
        "8.1: control improves on that by a Markov approximation", "improved",
        *(
            above(f"decay rate of E|x|^2 (1/s), gain norm <= {bound:g}", f"semi[{n}]", f"markov[{n}]")
            for n, bound in enumerate(BOUNDS)
        ),
        computed="{semi[0]:.3f}/s and {markov[0]:.3f}/s; {semi[1]:.3f}/s and {markov[1]:.3f}/s; {semi[2]:.3f}/s and "
        "{markov[2]:.3f}/s",
        basis="the nominal example, exact second moments over the rates (2.26). Gains of largest certified decay: two sections, "
        "linear in h; and one gain a mode for constant rates with the same mean sojourn of {stay:.4f} s",
    ),
)  # fmt: skip
