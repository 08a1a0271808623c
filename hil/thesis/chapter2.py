"""Chapter 2: stability and robust control of semi-Markov jump linear systems; the example (2.25)-(2.28)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import product
from typing import Any

import numpy as np

from design.as_printed import CHAPTER2_BOUNDARY_S, chapter2_gain, chapter2_process, chapter2_reference_gain, chapter2_system
from design.as_printed.chapters_2_to_4 import PrintedRequest, printed_stability
from design.processes.partitions import Partition, equal_probability, rate_threshold, uniform
from design.processes.rates import PiecewiseLinearRate, constant_rate
from design.processes.semi_markov import SemiMarkov
from design.semi_markov_loop import JumpSystem
from design.semi_markov_loop.robust_feedback import FeedbackRequest, Synthesis, largest_uncertainty
from design.semi_markov_loop.second_moments import second_moment_decay, second_moment_radius
from design.semi_markov_loop.stability import analyse
from hil.pages import BarGroup, Bars
from hil.thesis import Chapter, Plot, ReportProgress, Stage
from hil.thesis.chapter2_feasibility import FEASIBILITY, FORMS, MARKOV, SECTIONS, Form, feasibility, markov, verdict_of
from hil.thesis.chapter2_runs import IN_THE_LOOP, SETTLING, in_the_loop, settling, weibull_process
from hil.thesis.statements import Statement, above, below, equal, exactly, number_of, says, statement


def certified_scales(lines: Mapping[Form, list[float]]) -> Plot:
    """What every method certifies, by the number of sections."""
    names: dict[Form, str] = {"pwl": "linear in h (ours)", "pwc": "constant per section (sound)", "printed": "printed (unsound)"}
    groups = tuple(BarGroup(label=name, values=lines[form], hollow=form == "printed") for form, name in names.items())
    bars = Bars(
        title="largest certified scale of the uncertainty", categories=[f"M = {n}" for n in SECTIONS], groups=groups,
        x_label="sections", y_label="scale",
    )  # fmt: skip
    intro = "A_i(t), B_2(t) as printed, equal probability, |K| <= 100."
    return Plot(title="What partitioning buys", panels=(bars,), intro=intro)


LOW, HIGH, FROM_S = 0.01, 200.0, 0.4967
THEOREMS = (f"hazard {LOW:g}, then {HIGH:g} from {FROM_S:g} s", "the thesis's own rates (2.26), M = 12 uniform sections")


def _theorems(report_progress: ReportProgress) -> dict[str, Any]:
    """Systems that the printed conditions accept and that diverge."""
    step = PiecewiseLinearRate(times_s=(0.0, FROM_S, FROM_S), values=(LOW, LOW, HIGH))
    process = SemiMarkov(rates=((None, step), (step, None)))
    first = _autonomous([[-0.6, -1], [10, -0.6]], [[-0.6, -10], [1, -0.6]])
    second = _autonomous([[-0.7606, -0.2], [3.2, -0.7606]], [[-0.7606, -3.2], [0.2, -0.7606]])
    wide = PiecewiseLinearRate(times_s=(0.0, 1.0), values=(0.1, 10.0))
    back = constant_rate(3.0)
    three = _autonomous([[-0.05]], [[0.65]], [[-6.0]])
    box = SemiMarkov(rates=((None, wide, wide), (back, None, None), (back, None, None)))
    low, high = box.bounds(0, 0.0, math.inf)
    corner = (None, constant_rate(float(high[1])), constant_rate(float(low[2])))
    worst = SemiMarkov(rates=(corner, (back, None, None), (back, None, None)))
    cases = ((first, process, ((0.0, FROM_S),) * 2), (second, chapter2_process(), uniform(chapter2_process(), 12)))
    accepted = [printed_stability(system, None, law, nodes=nodes) for system, law, nodes in cases]
    accepted.append(printed_stability(three, None, box, nodes=((0.0,),) * 3))
    return {
        "accepted": accepted, "margins": [verdict_of(each) for each in accepted],
        "ours": [
            *(analyse(system, None, law, nodes=nodes).verdict for system, law, nodes in cases),
            analyse(three, None, box, method="pwc", nodes=((0.0,),) * 3).verdict,
        ],
        "growth": [
            *(analyse(system, None, law, method="exact").spectral_radius for system, law, _ in cases),
            -number_of(analyse(three, None, worst, method="exact").decay_rate),
        ],
    }  # fmt: skip


def _accepted_yet(item: str, number: int, growth: str, limit: float, basis: str) -> Statement:
    """The printed condition accepts a system that the exact growth refutes."""
    return statement(
        item, "stochastically stable", below(growth, f"growth[{number}]", limit),
        witness=(
            says("printed condition", f"accepted[{number}].verdict", "certified"), above(growth, f"growth[{number}]", limit),
        ),
        computed=f"printed: {{margins[{number}]}}; ours: {{ours[{number}]}}; {growth} {{growth[{number}]:.4g}}", basis=basis,
    )  # fmt: skip


# fmt: off
COUNTEREXAMPLES = (
    *(
        _accepted_yet(
            f"Corollary 2.1 is sufficient for stability ({what})", n, "growth of the second moments per jump", 1.0,
            "jumps land in section 1, sections need a link",
        )
        for n, what in enumerate(THEOREMS)
    ),
    _accepted_yet(
        "Theorem 2.2 covers the rate box for N = 3", 2, "growth of E|x|^2 at rates (10, 0.1) (1/s)", 0.0,
        "two corners span a segment only",
    ),
)
# fmt: on


def _autonomous(*modes: list[list[float]]) -> JumpSystem:
    a = np.array(modes, dtype=float)
    return JumpSystem(a=a, b=np.zeros((*a.shape[:2], 1)))


GAINS = {"ours": ("(2.27)", chapter2_gain), "other": ("[1, 2]", chapter2_reference_gain)}

CELLS_S: Partition = ((0.0, 0.2, 0.4, CHAPTER2_BOUNDARY_S, 1.2, 1.8, 2.5, 3.5, 4.6),) * 2
"""Between which a Lyapunov matrix is linear."""


def _moments(report_progress: ReportProgress) -> dict[str, Any]:
    """Exact second moments of the example under both controllers, for every constant sigma, rho of -1, 0 and 1."""
    process, nominal, moved = chapter2_process(), chapter2_system("none"), chapter2_system("vertices")
    ends = [nominal, moved.at_vertex(0), moved.at_vertex(1)]
    each = [JumpSystem(a=np.stack([one.a[0], two.a[1]]), b=np.stack([one.b[0], two.b[1]])) for one, two in product(ends, ends)]
    return {
        name: {
            "radius": second_moment_radius(nominal, gain(), process), "decay": second_moment_decay(nominal, gain(), process) / 2,
            "worst": float(np.max([second_moment_radius(system, gain(), process) for system in each])),
            "always": analyse(moved, gain(), process, method="pwl", nodes=CELLS_S).verdict,
        }
        for name, (_, gain) in GAINS.items()
    }  # fmt: skip


def _rates(report_progress: ReportProgress) -> dict[str, Any]:
    """The Weibull law, its rate and the section boundary."""
    h = np.array([0.1, 4.6])
    law = weibull_process()
    rate = law.rates[0][1]
    assert rate is not None
    return {
        "rate": rate(h).tolist(),
        "plain": float(np.exp(-0.5 * h[0] ** 2) - np.exp(-0.5 * h[1] ** 2)),
        "doubled": float(-np.diff(np.exp(-rate.integral(h)))[0]),
        "median": [float(p.sojourn(0, np.array(np.log(2.0)))) for p in (law, chapter2_process())],
    }


TOLERANCE = 2e-3
"""Of the largest certified scale, relative: less growth than this is none."""


def _scale(form: Form, sections: int | Partition) -> float:
    """Largest scale of the uncertainty for which a form of the condition has gains."""
    asked: dict[str, Any] = {"process": chapter2_process(), "gain_bound": 100.0, "sections": sections}
    request: Synthesis = PrintedRequest(**asked) if form == "printed" else FeedbackRequest(**asked, method=form)
    return largest_uncertainty(chapter2_system("vertices"), request, tolerance=TOLERANCE)[0]


def _scales(report_progress: ReportProgress) -> dict[str, Any]:
    """What every method certifies, by the number of sections."""
    lines: dict[Form, list[float]] = {form: [] for form in FORMS}
    for n, (form, sections) in enumerate(product(FORMS, SECTIONS)):
        report_progress(f"{form}, {sections} sections", n, len(FORMS) * len(SECTIONS))
        lines[form].append(_scale(form, sections))
    return {
        "least": {form: float((np.diff(line) / line[:-1]).min()) for form, line in lines.items()},
        "figures": (certified_scales(lines),),
        "line": {form: ", ".join(f"{scale:.2f}" for scale in line) for form, line in lines.items()},
    }  # fmt: skip


STRATEGIES = ("(2.22)", "(2.23)", "(2.24)")


def _strategies(report_progress: ReportProgress) -> dict[str, Any]:
    """Largest scale that is certified with four sections by each strategy of Remark 2.2."""
    process = chapter2_process()
    cuts: tuple[Partition, ...] = (equal_probability(process, 4), uniform(process, 4), rate_threshold(process, 4.5 / 4))
    scales: dict[Form, list[float]] = {"pwc": [], "pwl": []}
    for n, (form, (name, cut)) in enumerate(product(scales, zip(STRATEGIES, cuts, strict=True))):
        report_progress(f"{form}, {name}", n, len(scales) * len(cuts))
        scales[form].append(_scale(form, cut))
    roles = {form: {"scales": found, "role": max(found) / min(found)} for form, found in scales.items()}
    return roles | {"sections": [len(cut[0]) for cut in cuts]}


# fmt: off
REMARK_2_2 = (
    statement(
        "the partition strategy plays a significant role: largest scale of the uncertainty by (2.22), (2.23), (2.24)",
        "Remark 2.2",
        above("best over worst strategy, constant per section", "pwc[role]", 1.1),
        above("best over worst strategy, linear in h", "pwl[role]", 1.1),
        readings=True,
        beside=tuple(exactly(f"sections of {name}", f"sections[{n}]", 4) for n, name in enumerate(STRATEGIES)),
        computed="sound, constant per section: {pwc[scales][0]:.3f}, {pwc[scales][1]:.3f}, {pwc[scales][2]:.3f}; linear in h: "
        "{pwl[scales][0]:.3f}, {pwl[scales][1]:.3f}, {pwl[scales][2]:.3f}",
        basis="significant: by a tenth; neither size nor condition is printed; M = 4, (2.24) with a threshold of a quarter of "
        "the range of the rate; A_i(t), B_2(t) as printed, |K| <= 100",
    ),
)
MOMENTS = tuple(
    statement(
        f"gains {label} stabilise the example", "stochastically stable",
        below("largest radius per jump", f"{name}[worst]", 1.0),
        says("for any sigma(t), rho(t), linear in h", f"{name}[always]", "certified"),
        witness=(above("largest radius per jump", f"{name}[worst]", 1.0),),
        computed=f"nominal: radius {{{name}[radius]:.5f}} per jump, |x| decays at {{{name}[decay]:.4f}}/s; "
        f"constant sigma, rho of -1, 0, 1: largest radius {{{name}[worst]:.4g}}; any: {{{name}[always]}}",
        basis="exact second moments, A_i(t), B_2(t) as printed; eight cells of h",
    )
    for name, (label, _) in GAINS.items()
)
RATES = (
    statement(
        "Weibull, scale 1 and shape 2, has the rate h", "lambda(h) = h",
        *(exactly(f"rate at h = {h:g} s (1/s)", f"rate[{n}]", h, 1e-6) for n, h in enumerate((0.1, 4.6))),
        witness=tuple(exactly(f"rate at h = {h:g} s (1/s)", f"rate[{n}]", 2 * h, 1e-6) for n, h in enumerate((0.1, 4.6))),
        basis="f/(1 - F) = 2h exp(-h^2)/exp(-h^2) = 2h",
    ),
    statement(
        "Pr{0.1 <= h <= 4.6}", "> 0.99", above("with the rate h", "plain", 0.99), above("with the rate 2h", "doubled", 0.99),
    ),
    statement(
        "h = 0.8326 halves the probability (2.22), for the printed rate (2.26)", "0.8326 s",
        equal("median (s)", "median[1]", "0.8326"),
        beside=(equal("median of the Weibull law (rate 2h) (s)", "median[0]", "0.8326"),),
        basis="the Weibull law, rate 2h, has the median {median[0]:.4f} s",
    ),
)
SCALES = (
    statement(
        "partitioning reduces conservativeness: largest scale of the uncertainty, M = 1, 2, 4, 8", "Section 2.4",
        above("least growth from one M to the next, relative, linear in h", "least[pwl]", TOLERANCE),
        above("least growth from one M to the next, relative, constant per section", "least[pwc]", TOLERANCE),
        computed="ours, linear in h: {line[pwl]}; sound, constant per section: {line[pwc]}; printed (unsound): {line[printed]}",
        basis="A_i(t), B_2(t) as printed, equal probability (2.22), |K| <= 100; the form matters more than M, and the printed "
        "form gains partly because more sections make it less sound",
    ),
)
CHAPTER = Chapter(
    title="Chapter 2: semi-Markov jump linear systems",
    stages=(
        Stage("feasibility claims", feasibility, 5, FEASIBILITY),
        Stage("theorems", _theorems, 0.5, COUNTEREXAMPLES),
        Stage("exact second moments", _moments, 0.5, MOMENTS),
        Stage("rates and partition", _rates, 0.1, RATES),
        Stage("settling times", settling, 20, SETTLING),
        Stage("runs of the emulated loop", in_the_loop, 12, IN_THE_LOOP),
        Stage("certified scales", _scales, 17, SCALES),
        Stage("partition strategies", _strategies, 10, REMARK_2_2),
        Stage("a Markov approximation", markov, 6, MARKOV),
    ),
)
# fmt: on
