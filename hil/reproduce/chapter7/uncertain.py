"""Remark 7.6: gains for norm-bounded plants (7.41), beside those for the nominal one."""

from __future__ import annotations

import math
from typing import Any

from design.errors import DesignError
from design.networked_loop.uncertainty import robust_h2, uncertainty_margin
from design.requests.tracking import solve_tracking
from design.tracking.synthesis import Design
from hil.design_questions.design_problem import problem_for, tracking_target
from hil.design_questions.plant_uncertainty import PlantSet, interval, judge_uncertain, plants_between, robust_design
from hil.reproduce.chapter import ReportProgress
from hil.reproduce.statements import Statement, above, below, says

NARROW, WIDE = 10, 30
"""Uncertainty of the motor's gain, per cent to either side: what the nominal gains bear, and more than that."""


def uncertain(report_progress: ReportProgress) -> dict[str, Any]:
    """Margins, guaranteed costs and verdicts of both designs."""
    target = tracking_target("dc-motor")
    nominal = solve_tracking(problem_for(target))
    values: dict[str, Any] = {"nominal_h2": nominal.certificate.h2_norm}
    for n, (name, percent) in enumerate((("narrow", NARROW), ("wide", WIDE))):
        report_progress(f"gain +-{percent} %", n, 2)
        asked = [interval(target.of, f"gain={percent}%")]
        plants, ours = plants_between(target, asked), robust_design(target, nominal, asked)
        both = {"nominal": nominal, "ours": ours}
        margin = {who: _margin(design, plants) for who, design in both.items()}
        values[name] = {
            "margin": margin, "ratio": margin["ours"] / margin["nominal"],
            "cost": {who: _guaranteed(design, plants) for who, design in both.items()},
            "verdict": {who: judge_uncertain(target, design, asked).state for who, design in both.items()},
            "h2": ours.certificate.h2_norm,
        }  # fmt: skip
    return values


def _margin(design: Design, plants: PlantSet) -> float:
    return uncertainty_margin(design.problem.structure(), design.gains, plants.M, plants.N1, plants.N2)


def _guaranteed(design: Design, plants: PlantSet) -> float:
    try:
        return robust_h2(design.problem.structure(), design.gains, plants.M, plants.N1, plants.N2)[0]
    except DesignError:
        return math.inf


UNCERTAIN = (
    Statement(
        f"(7.41), Remark 7.6: gains for norm-bounded plants bear what the nominal ones do not, gain +-{WIDE} %", "can be solved",
        (
            says("verdict on our gains", "wide[verdict][ours]", "certified"),
            below("share of it that the small-gain theorem proves for the nominal gains", "wide[margin][nominal]", 1),
            above("the same for ours", "wide[margin][ours]", 1),
        ),
        computed="{wide[margin][ours]:.3f} of it against {wide[margin][nominal]:.3f}, {wide[ratio]:.2f} times; without "
        "uncertainty the H2 norm is {wide[h2]:.3f} against {nominal_h2:.3f}",
        basis="the motor over its network, H2, stacked z, rows by the d when they are applied; no design is printed. Verdict on "
        "the nominal gains: {wide[verdict][nominal]}",
    ),
    Statement(
        f"(7.41): the guaranteed cost of such gains is less than that of the nominal ones, gain +-{NARROW} %", "-",
        (
            below("guaranteed H2 norm over that of the nominal gains", "narrow[cost][ours]", "narrow[cost][nominal]"),
            above("certified uncertainty over that of the nominal gains", "narrow[ratio]", 1.05),
        ),
        computed="{narrow[cost][ours]:.4f} against {narrow[cost][nominal]:.4f}; they bear {narrow[ratio]:.2f} times as much",
        basis="both by the multiplier that proves least; without uncertainty {narrow[h2]:.3f} against {nominal_h2:.3f}",
    ),
)
