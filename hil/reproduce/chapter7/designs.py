"""Norms and gains of Section 7.4: published, recomputed from the published gains, and the best that we find."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from design.tracking.synthesis import Design, TrackingProblem, solve
from hil.report.html.figures import BarGroup, Bars, Figure, Series
from hil.reproduce.chapter import Part, Plot, ReportProgress
from hil.reproduce.chapter7.all_cores import on_all_cores
from hil.reproduce.chapter7.models import (
    H2,
    HINF,
    NETWORK,
    PRINTED_MOTOR,
    VTOL_H2,
    VTOL_HINF,
    Array,
    Plant,
    motor,
    norms_of,
    vtol,
)
from hil.reproduce.judgement import Row, above, below, near, row

PLANTS: dict[str, Callable[[], Plant]] = {"motor": motor, "vtol": vtol}
NAME = {"motor": "motor", "vtol": "VTOL"}
NAMES = {"h2": "H2", "hinf": "H-infinity"}
PROBLEMS = (("vtol", "hinf"), ("vtol", "h2"), ("motor", "hinf"), ("motor", "h2"))
INFORMATION = ("constant", "tau", "previous", "generated", "total", "applied", "both")
WORDS = {
    "constant": "nothing", "tau": "tau", "previous": "d before", "generated": "d made", "total": "age", "applied": "d applied",
    "both": "both d",
}  # fmt: skip
BOUNDS = (1.0, 2.0, 4.5, 7.0, 40.0)


def best(plant: Plant, **options: Any) -> Design:
    """Our design for a plant of Section 7.4 over its network."""
    return solve(TrackingProblem(A=plant.A, B=plant.B, C=plant.C, sc=NETWORK[0], ca=NETWORK[1], **options))


def designs(report_progress: ReportProgress) -> Part:
    """Published minima and gains of both plants against the best that we find."""
    asked = [(*key, output) for key in PROBLEMS for output in ("sum", "stacked")]
    found: dict[tuple[str, str, str], Design] = {}
    spent = dict.fromkeys(PLANTS, 0.0)
    solved = on_all_cores(_design_of, asked, report_progress, [f"{NAME[n]}, {NAMES[o]}, z {z}" for n, o, z in asked])
    for key, (design, seconds) in zip(asked, solved, strict=True):
        found[key] = design
        spent[key[0]] += seconds
    rows = [*_motor_rows(found), *_vtol_rows(found)]
    rows += [
        row(
            f"{name}: time for the two designs", f"{hours} h on a PC of 2012", below("CPU time (h)", spent[key] / 3600.0, hours),
            computed=f"{spent[key]:.1f} s of CPU time for four, this machine",
            basis="four: H2 and H-infinity, z stacked and summed, with all starts",
        )
        for name, key, hours in (("motor", "motor", 1.93), ("VTOL", "vtol", 8.23))
    ]  # fmt: skip
    return Part(rows=tuple(rows))


def _design_of(name: str, objective: str, output: str) -> tuple[Design, float]:
    begun = time.process_time()
    design = best(PLANTS[name](), objective=objective, information="generated", output=output)
    return design, time.process_time() - begun


def _gains(design: Design) -> str:
    return ", ".join("/".join(f"{v:.4f}" for v in gain) for gain in design.gains.reshape(6, -1))


def _motor_rows(found: dict[tuple[str, str, str], Design]) -> list[Row]:
    hinf, h2 = found["motor", "hinf", "sum"], found["motor", "h2", "sum"]
    wrong = norms_of(Plant(*PRINTED_MOTOR, motor().C), HINF)[1]
    at_published = norms_of(motor(), HINF)[1]
    off = float(np.abs(hinf.gains - HINF).max())
    beta = norms_of(motor(), H2)[0]
    return [
        row(
            "motor: gamma_min", "17.4085", near("norm with (7.36)", at_published, 17.4085, relative=5e-4),
            near("smallest norm found", _norm(hinf, "hinf"), 17.4085, relative=5e-4),
            basis=f"z = Q x + R u1 as printed (a sum), on the correct model; with the printed A, B it would be {wrong:.1f}",
        ),
        row(
            "motor: H-infinity gains (7.36)", "-.1576 -.1318 -.0878 .0091 -.0342 .0074",
            below("largest difference", off, 0.01), computed=_gains(hinf), basis=f"largest difference {off:.4f}",
        ),
        row(
            "motor: beta_min", "5.0147", near("norm with (7.37)", beta, 5.0147, relative=0.01),
            near("smallest norm found", _norm(h2, "h2"), 5.0147, relative=0.01),
            basis="no initial distribution, R or stacking that was tried gives the printed number",
        ),
        row(
            "motor: H2 gains (7.37)", "-.1980 -.1647 -.1232 -.0547 -.0747 -.0399",
            below("largest difference", float(np.abs(h2.gains - H2).max()), 0.01), computed=_gains(h2),
            basis=f"largest difference {float(np.abs(h2.gains - H2).max()):.3f}; the norms differ by "
            f"{beta / _norm(h2, 'h2') - 1:.2%}: the optimum is flat, and the published gains lie near it",
        ),
    ]  # fmt: skip


def _norm(design: Design, objective: str) -> float:
    value = design.certificate.h2_norm if objective == "h2" else design.certificate.hinf_norm
    return np.nan if value is None else float(value)


def _vtol_rows(found: dict[tuple[str, str, str], Design]) -> list[Row]:
    rows = []
    for symbol, objective, gains, printed, tolerance in (
        ("beta_min", "h2", VTOL_H2, 0.1225, 0.01), ("gamma_min", "hinf", VTOL_HINF, 0.3464, 0.03),
    ):  # fmt: skip
        norm = norms_of(vtol(), gains)[objective == "hinf"]
        both = {output: found["vtol", objective, output] for output in ("sum", "stacked")}
        least = {output: _norm(design, objective) for output, design in both.items()}
        words = ", ".join(f"{least[o]:.4f} ({o}, gains up to {np.abs(d.gains).max():.3g})" for o, d in both.items())
        rows += [
            row(
                f"VTOL: the published gains have the norm {symbol}", f"{printed}",
                near("norm with the published gains, z a sum,", norm, printed, relative=tolerance),
                basis=f"within {tolerance:.0%}; the print of gamma_min is a level that an inequality met",
            ),
            row(
                f"VTOL: {symbol} is the minimum", f"{printed}",
                above("smallest norm found, z a sum,", least["sum"], printed * (1 - tolerance)),
                computed=f"best {words}",
                witness=(below("smallest norm found, z a sum,", least["sum"], printed * (1 - tolerance)),),
                basis="the best gains let Q x and R u cancel in the sum; with z stacked they do not",
            ),
            *(
                row(
                    f"VTOL: {NAMES[objective]} gain K({tau},{d}) of 7.4.1", _vector(gains[tau, d]),
                    below("largest difference, z a sum,", _off(both["sum"], gains, tau, d), 0.05),
                    below("largest difference, z stacked,", _off(both["stacked"], gains, tau, d), 0.05),
                    computed="; ".join(f"{_vector(design.gains[tau, d])} ({output})" for output, design in both.items()),
                    basis="the optimum of the same problem; each must lie within 0.05 in both entries",
                )
                for tau in range(3)
                for d in range(2)
            ),
        ]  # fmt: skip
    return rows


def _vector(gain: Array) -> str:
    return "[" + " ".join(f"{v:.4f}" for v in gain[:, 0]) + "]"


def _off(design: Design, gains: Array, tau: int, d: int) -> float:
    return float(np.abs(design.gains[tau, d] - gains[tau, d]).max())


def information(report_progress: ReportProgress) -> Part:
    """What each piece of information is worth, on both plants, and the printed rule against [53]."""
    series = [(name, objective) for name in PLANTS for objective in ("h2", "hinf")]
    asked = [(name, {"objective": objective, "information": i, "starts": 1}) for name, objective in series for i in INFORMATION]
    norms = iter(_norms(asked, report_progress))
    values = {key: [next(norms) for _ in INFORMATION] for key in series}
    groups = tuple(
        BarGroup(label=f"{NAME[name]} {objective}", values=[v / found[0] for v in found])
        for (name, objective), found in values.items()
    )
    bars = Bars(
        title="Best norm by what the gain may depend on, relative to one constant gain",
        categories=[WORDS[i] for i in INFORMATION], groups=groups, y_label="norm / norm of one gain",
        note="Besides tau: d before the packet was made [53], when it was made (printed), when it is applied, or both; age is "
        "the sum of tau and d. Stacked z, R = 0.01, uniform initial distribution.",
    )  # fmt: skip
    printed, applied, before = (INFORMATION.index(word) for word in ("generated", "applied", "previous"))
    rows = []
    for (name, objective), found in values.items():
        words = f"smallest {NAMES[objective]} norm"
        rows.append(
            row(
                f"{NAME[name]}, {NAMES[objective]}: the row for d at generation is more effective than the one before [53]",
                "more effective (Remark 7.3, Section 7.5)", below(f"{words}, d at generation", found[printed], found[before]),
                computed=f"{found[printed]:.5f} against {found[before]:.5f} with d before; d at application {found[applied]:.5f}",
                witness=(above(f"{words}, d at generation", found[printed], found[before]),),
                basis="by (7.9)-(7.13) the applied row belongs to the d of the slot that made the packet; the actuator knows the "
                f"current one, which gains {1 - found[applied] / found[printed]:.1%}; stacked z, R = 0.01",
            )
        )  # fmt: skip
    return Part(rows=tuple(rows), figures=(Plot(title="What the actuator knows", panels=(bars,)),))


def _norms(asked: Sequence[tuple[str, dict[str, Any]]], report_progress: ReportProgress) -> list[float]:
    """The norm that each problem asks for, in order."""
    return on_all_cores(_norm_of, asked, report_progress, [f"{NAME[name]}, {options['objective']}" for name, options in asked])


def _norm_of(name: str, options: dict[str, Any]) -> float:
    return _norm(best(PLANTS[name](), **options), options["objective"])


def gain_bounds(report_progress: ReportProgress) -> Part:
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
    return Part(figures=(Plot(title="Norm against gain bound", panels=(figure,)),))
