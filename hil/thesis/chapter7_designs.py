"""Norms and gains of Section 7.4: published, recomputed from the published gains, and the best that we find.

And gains for uncertain plants (7.41).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from design.networked_loop.affine_loop import LoopStructure
from design.networked_loop.uncertainty import robust_h2, uncertainty_margin
from design.requests.tracking import solve_tracking
from design.tracking.synthesis import Design, TrackingProblem, solve
from hil.design_questions import problem_for, tracking_target
from hil.design_questions.plant_uncertainty import PlantSet, interval, judge_uncertain, plants_between, robust_design
from hil.pages import BarGroup, Bars, Figure, Series
from hil.thesis import Array, Plot, ReportProgress
from hil.thesis.chapter7_models import H2, HALF, HINF, NETWORK, PRINTED_MOTOR, VTOL_H2, VTOL_HINF, Plant, motor, norm_of, vtol
from hil.thesis.chapter7_runs import on_all_cores
from hil.thesis.statements import above, below, equal, exactly, not_judged, says, statement, within

PLANTS: dict[str, Callable[[], Plant]] = {"motor": motor, "vtol": vtol}
NAME = {"motor": "motor", "vtol": "VTOL"}
NAMES = {"h2": "H2", "hinf": "H-infinity"}
PROBLEMS = (("vtol", "hinf"), ("vtol", "h2"), ("motor", "hinf"), ("motor", "h2"))
RIVALS = ("previous", "generated")
INFORMATION = ("constant", "tau", "previous", "generated", "total", "applied", "both")
WORDS = {
    "constant": "nothing", "tau": "tau", "previous": "d before", "generated": "d made", "total": "age", "applied": "d applied",
    "both": "both d",
}  # fmt: skip
TIE = 1e-4
"""Norms of two descents that differ by less than this share are one; those of one problem agree to 1e-10."""
BOUNDS = (1.0, 2.0, 4.5, 7.0, 40.0)
GAINS = {("vtol", "hinf"): VTOL_HINF, ("vtol", "h2"): VTOL_H2, ("motor", "hinf"): HINF, ("motor", "h2"): H2}
SERIES = tuple((name, objective) for name in PLANTS for objective in ("h2", "hinf"))


def best(plant: Plant, **options: Any) -> Design:
    """Our design for a plant of Section 7.4 over its network."""
    return solve(TrackingProblem(A=plant.A, B=plant.B, C=plant.C, sc=NETWORK[0], ca=NETWORK[1], **options))


def designs(report_progress: ReportProgress) -> dict[str, Any]:
    """Published minima and gains of both plants against the best that we find."""
    asked = [(*key, output) for key in PROBLEMS for output in ("sum", "stacked")]
    spent = dict.fromkeys(PLANTS, 0.0)
    solved = on_all_cores(_design_of, asked, report_progress, [f"{NAME[n]}, {NAMES[o]}, z {z}" for n, o, z in asked])
    found: dict[str, Any] = {"seconds": spent}
    for (name, objective, output), (design, seconds) in zip(asked, solved, strict=True):
        gains = GAINS[name, objective]
        spent[name] += seconds
        found[f"{name}_{objective}_{output}"] = {
            "norm": _norm(design, objective), "gains": design.gains, "largest": np.abs(design.gains).max(),
            "off": float(np.abs(design.gains - gains).max()), "each": np.abs(design.gains - gains).max(axis=(2, 3)),
            "words": ", ".join("/".join(f"{v:.4f}" for v in gain) for gain in design.gains.reshape(6, -1)),
        }  # fmt: skip
    for name, objective in GAINS:
        each = found[f"{name}_{objective}"] = published(name, objective)
        each["least"] = found[f"{name}_{objective}_sum"]["norm"] / each["norm"]
    return found | {"wrong": norm_of(Plant(*PRINTED_MOTOR, motor().C), HINF, "hinf")}


def published(name: str, objective: str) -> dict[str, float]:
    """The norm of published gains, what the rounding of all their digits may move it by, and the largest of them."""
    gains, plant = GAINS[name, objective], PLANTS[name]()
    norm = norm_of(plant, gains, objective)
    moved = [norm_of(plant, gains + HALF * e.reshape(gains.shape), objective) for e in np.eye(gains.size)]
    return {"norm": norm, "rounding": float(np.abs(np.subtract(moved, norm)).sum()), "size": float(np.abs(gains).max())}


def _design_of(name: str, objective: str, output: str) -> tuple[Design, float]:
    begun = time.process_time()
    design = best(PLANTS[name](), objective=objective, information="generated", output=output)
    return design, time.process_time() - begun


def _norm(design: Design, objective: str) -> float:
    value = design.certificate.h2_norm if objective == "h2" else design.certificate.hinf_norm
    return np.nan if value is None else float(value)


def information(report_progress: ReportProgress) -> dict[str, Any]:
    """What each piece of information is worth, on both plants, and the printed rule against [53]."""
    keys = [(*key, z, i) for key in SERIES for z, patterns in (("sum", RIVALS), ("stacked", INFORMATION)) for i in patterns]
    asked = [
        (name, {"objective": objective, "output": z, "information": i, "starts": 1 if z == "stacked" else 0})
        for name, objective, z, i in keys
    ]
    norms = dict(zip(keys, _norms(asked, report_progress), strict=True))
    values = {key: [norms[*key, "stacked", i] for i in INFORMATION] for key in SERIES}
    bars = Bars(
        title="Best norm by what the gain may depend on, relative to one constant gain",
        categories=[WORDS[i] for i in INFORMATION], y_label="norm / norm of one gain",
        groups=tuple(
            BarGroup(label=f"{NAME[name]} {objective}", values=[v / found[0] for v in found])
            for (name, objective), found in values.items()
        ),
        note="Besides tau: d before the packet was made [53], when it was made (printed), when it is applied, or both; age is "
        "the sum of tau and d. Stacked z, R = 0.01, uniform initial distribution.",
    )  # fmt: skip
    named: dict[str, dict[str, Any]] = {
        f"{name}_{objective}": dict(zip(INFORMATION, found, strict=True)) for (name, objective), found in values.items()
    }
    for key, found in zip(SERIES, named.values(), strict=True):
        found["sum"] = {i: norms[*key, "sum", i] for i in RIVALS}
        found["sum"]["before"] = found["sum"]["generated"] / found["sum"]["previous"] - 1
        found["gained"] = 1 - found["applied"] / found["generated"]
        found["before"], found["one"] = (found["generated"] / found[name] - 1 for name in ("previous", "constant"))
    return named | {"figures": (Plot(title="What the actuator knows", panels=(bars,)),)}


def _norms(asked: Sequence[tuple[str, dict[str, Any]]], report_progress: ReportProgress) -> list[float]:
    """The norm that each problem asks for, in order."""
    return on_all_cores(_norm_of, asked, report_progress, [f"{NAME[name]}, {options['objective']}" for name, options in asked])


def _norm_of(name: str, options: dict[str, Any]) -> float:
    return _norm(best(PLANTS[name](), **options), options["objective"])


def gain_bounds(report_progress: ReportProgress) -> dict[str, Any]:
    """H-infinity norm of the VTOL against the bound on its gains, for both readings of z."""
    outputs = ("stacked", "sum")
    options = {"objective": "hinf", "information": "generated"}
    asked = [
        ("vtol", {**options, "output": output, "gain_bound": bound, "starts": 1})
        for output in reversed(outputs)  # the longest first
        for bound in reversed(BOUNDS)
    ]
    norms = np.array(_norms(asked, report_progress)).reshape(len(outputs), len(BOUNDS))[::-1, ::-1]
    curves = tuple(
        Series(label=f"z {output}", x=np.array(BOUNDS), y=np.minimum.accumulate(np.nan_to_num(found, nan=np.inf)))
        for output, found in zip(outputs, norms, strict=True)
    )
    figure = Figure(
        title="Smallest H-infinity norm of the VTOL", series=curves, x_label="bound on every |gain|", x_unit="",
        y_label="norm", x_log=True, y_log=True, sync=None, note="a larger bound keeps every design of a smaller one",
    )  # fmt: skip
    return {"figures": (Plot(title="Norm against gain bound", panels=(figure,)),)}


def _vector(gain: Array) -> str:
    return "[" + " ".join(f"{v:.4f}" for v in gain[:, 0]) + "]"


# fmt: off
DESIGNS = (
    *(
        each
        for name, symbol, objective, printed, basis in (
            ("motor", "gamma_min", "hinf", "17.4085", "on the correct model; with the printed A, B it would be {wrong:.1f}"),
            ("motor", "beta_min", "h2", "5.0147", "no initial distribution, R or stacking that was tried gives the printed"),
            ("vtol", "beta_min", "h2", "0.1225", "the minimum has a row of its own"),
            ("vtol", "gamma_min", "hinf", "0.3464", "the minimum has a row of its own"),
        )
        for key in [f"{name}_{objective}"]
        for each in (
            statement(
                f"{NAME[name]}: the published gains have the norm {symbol}", printed,
                equal("norm with the published gains", f"{key}[norm]", printed, f"{key}[rounding]"),
                beside=(equal("smallest norm found", f"{key}_sum[norm]", printed),),
                computed=f"{{{key}[norm]:.5g}}; smallest norm found {{{key}_sum[norm]:.5g}}",
                basis="z = Q x + R u1 as printed (a sum); an inequality that meets a level says only that the norm is below it; "
                + basis,
            ),
            statement(
                f"{NAME[name]}: {symbol} is the minimum", "the minimum",
                within("smallest norm found over that of the published gains", f"{key}[least]", 0.999, 1.001),
                witness=(below("smallest norm found over that of the published gains", f"{key}[least]", 0.999),)
                * (name == "vtol"),
                computed=f"best {{{key}_sum[norm]:.4f}} (sum, gains up to {{{key}_sum[largest]:.3g}}), "
                f"{{{key}_stacked[norm]:.4f}} (stacked, gains up to {{{key}_stacked[largest]:.3g}})",
                basis="to a thousandth; " + (
                    "the best gains let Q x and R u cancel in the sum; with z stacked they do not" if name == "vtol"
                    else "no refutation, as the problem whose norm is printed is not known" if objective == "h2" else "z a sum"
                ),
            ),
        )
    ),
    *(
        statement(
            f"motor: {label}", printed,
            exactly("largest difference", f"motor_{key}_sum[off]", 0, HALF, f"motor_{key}[size]"),
            computed=f"{{motor_{key}_sum[words]}}",
            basis=f"half a unit of the last printed digit; largest difference {{motor_{key}_sum[off]:.4f}}, for a norm that is "
            f"{{motor_{key}[least]:.4f}} of that of the published gains: the optimum is flat",
        )
        for key, label, printed in (
            ("hinf", "H-infinity gains (7.36)", "-.1576 -.1318 -.0878 .0091 -.0342 .0074"),
            ("h2", "H2 gains (7.37)", "-.1980 -.1647 -.1232 -.0547 -.0747 -.0399"),
        )
    ),
    *(
        statement(
            f"VTOL: {NAMES[objective]} gain K({tau},{d}) of 7.4.1", _vector(GAINS["vtol", objective][tau, d]),
            exactly("largest difference, z a sum,", f"{key}_sum[each][{tau}][{d}]", 0, HALF, f"{key}[size]"),
            beside=(exactly("largest difference, z stacked,", f"{key}_stacked[each][{tau}][{d}]", 0, HALF, f"{key}[size]"),),
            computed="; ".join(
                f"[{{{key}_{z}[gains][{tau}][{d}][0][0]:.4f}} {{{key}_{z}[gains][{tau}][{d}][1][0]:.4f}}] ({z})"
                for z in ("sum", "stacked")
            ),
            basis="the optimum of the same problem; half a unit of the last printed digit in both entries",
        )
        for objective in ("h2", "hinf") for key in [f"vtol_{objective}"] for tau in range(3) for d in range(2)
    ),
    *(
        statement(
            f"{NAME[name]}: time for the two designs", f"{hours} h on a PC of 2012",
            not_judged("CPU time (s)", f"seconds[{name}]", "the PC of 2012 is not at hand"),
            computed=f"{{seconds[{name}]:.1f}} s of CPU time for four, this machine",
            basis="four: H2 and H-infinity, z stacked and summed, with all starts",
        )
        for name, hours in (("motor", 1.93), ("vtol", 8.23))
    ),
)
INFORMED = tuple(
    statement(
        f"{NAME[name]}, {NAMES[objective]}: the row for d at generation is more effective than the one before [53]",
        "more effective (Remark 7.3, Section 7.5)",
        *(
            below(f"smallest {NAMES[objective]} norm over that with d before, less 1, z {z},", f"{key}{at}[before]", -TIE)
            for z, at in (("a sum", "[sum]"), ("stacked", ""))
        ),
        readings=True,
        computed=f"z a sum, as printed: {{{key}[sum][generated]:.5f}} against {{{key}[sum][previous]:.5f}} with d before; "
        f"stacked: {{{key}[generated]:.5f}} against {{{key}[previous]:.5f}}, d at application {{{key}[applied]:.5f}}",
        basis="by (7.9)-(7.13) the applied row belongs to the d of the slot that made the packet; the actuator knows the "
        f"current one, which gains {{{key}[gained]:.1%}} (z stacked); R = 0.01",
    )
    for name, objective in SERIES for key in [f"{name}_{objective}"]
) + tuple(
    statement(
        f"{NAME[name]}, {NAMES[objective]}: gains that depend on both delays are less conservative than one that does not [47]",
        "Section 7.1, less conservative",
        below(f"smallest {NAMES[objective]} norm over that with one gain, less 1", f"{key}[one]", -TIE),
        computed=f"{{{key}[generated]:.5f}} against {{{key}[constant]:.5f}} with one gain; {{{key}[tau]:.5f}} with one a tau",
        basis="stacked z, R = 0.01",
    )
    for name, objective in SERIES for key in [f"{name}_{objective}"]
)
# fmt: on

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
        plants, ours = plants_between(target, nominal, asked), robust_design(target, nominal, asked)
        both = {"nominal": nominal, "ours": ours}
        margin = {who: uncertainty_margin(*_loop(design, plants)) for who, design in both.items()}
        values[name] = {
            "margin": margin, "ratio": margin["ours"] / margin["nominal"], "h2": ours.certificate.h2_norm,
            "verdict": {who: judge_uncertain(target, design, asked).state for who, design in both.items()},
        }  # fmt: skip
        if percent == NARROW:  # what the nominal gains do not bear has no cost
            values[name]["cost"] = {who: robust_h2(*_loop(design, plants))[0] for who, design in both.items()}
    return values


def _loop(design: Design, plants: PlantSet) -> tuple[LoopStructure, Array, Array, Array, Array]:
    return design.problem.structure(), design.gains, plants.M, plants.N1, plants.N2


UNCERTAIN = (
    statement(
        f"(7.41), Remark 7.6: gains for norm-bounded plants are proved for what the nominal ones are not, gain +-{WIDE} %",
        "can be solved",
        says("verdict on our gains", "wide[verdict][ours]", "certified"),
        below("share of it that the small-gain theorem proves for the nominal gains", "wide[margin][nominal]", 1),
        above("the same for ours", "wide[margin][ours]", 1),
        computed="{wide[margin][ours]:.3f} of it against {wide[margin][nominal]:.3f}, {wide[ratio]:.2f} times; without "
        "uncertainty the H2 norm is {wide[h2]:.3f} against {nominal_h2:.3f}",
        basis="the motor over its network, H2, stacked z, rows by the d when they are applied; no design is printed. Verdict on "
        "the nominal gains: {wide[verdict][nominal]}",
    ),
    statement(
        f"(7.41): the guaranteed cost of such gains is less than that of the nominal ones, gain +-{NARROW} %", "-",
        below("guaranteed H2 norm over that of the nominal gains", "narrow[cost][ours]", "narrow[cost][nominal]"),
        above("certified uncertainty over that of the nominal gains", "narrow[ratio]", 1.05),
        computed="{narrow[cost][ours]:.4f} against {narrow[cost][nominal]:.4f}; they bear {narrow[ratio]:.2f} times as much",
        basis="both by the multiplier that proves least; without uncertainty {narrow[h2]:.3f} against {nominal_h2:.3f}",
    ),
)  # fmt: skip
