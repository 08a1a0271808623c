"""Stages of chapters that take tenths of a second, by themselves: what they judge, and what they draw.

The slow tests reproduce whole chapters. Here stands what these stages computed on 2026-11-27, so that a mistake in what computes
it is seen. It holds to 1e-3 of its size; what is an error of rounding, or 0, is `SMALL`.
"""

from __future__ import annotations

import importlib
from functools import partial
from typing import Any

import numpy as np
import pytest

from design.as_printed.chapters_2_to_4 import PrintedRequest
from design.as_printed.examples import chapter3_gain
from design.monte_carlo.parallel_runs import Workers
from design.semi_markov_loop.certificate import JumpCertificate
from design.semi_markov_loop.robust_feedback import Synthesis
from design.semi_markov_loop.system import DelayedJumpSystem, JumpSystem
from design.tracking.synthesis import TrackingProblem
from hil.pages.html.figures import Bars, Figure, Histogram
from hil.thesis.chapter7_models import H2
from hil.thesis.noisy_runs import delayed_runs
from hil.thesis.statements import judge, named
from tests.hil.thesis.judging import assert_every_number_decides

SMALL = 0.0
JUDGED = None
"""Of rounding too, in a unit that makes it large: its verdict says enough."""
level = partial(pytest.approx, rel=0.02)
"""A solver's: to 2 %."""
Found = list[tuple[str, list[Any]]]

# fmt: off
ROWS: dict[tuple[str, str], Found] = {
    ("chapter2", "theorems"): [
        ("claim false", [5.4634, "certified", 5.4634]),
        ("claim false", [1.1075, "certified", 1.1075]),
        ("claim false", [0.98635, "certified", 0.98635]),
    ],
    ("chapter2", "exact second moments"): [
        ("reproduced", [0.43634, "certified", 0.43634]),
        ("claim false", [1.518, "refused", 1.518]),
    ],
    ("chapter2", "rates and partition"): [
        ("claim false", [0.2, 9.2, 0.2, 9.2]),
        ("reproduced", [0.99499, 0.99005]),
        ("not reproduced", [1.1732, 0.83255]),
    ],
    ("chapter2", "settling times"): [
        ("undecided", [3.1513, 0.97918]),
        ("undecided", [9.2028, 2.1149]),
        ("reproduced", [0.47541]),
        ("reproduced", [0.25]),
        ("reproduced", [4.9414]),
        ("undecided", [1.0013, 0.84749]),
        ("undecided", [1.8895, 1.5783]),
        ("undecided", [2.3325, 2.4563]),
    ],
    ("chapter4", "conditions"): [
        ("reproduced", ["certified", level(0.0623)]),
        ("reproduced", ["certified", "certified", level(0.02104), level(0.1469), "certified", level(0.01753)]),
        ("claim false", ["refused", "refused", 20.9945, 10.9035]),
        ("reproduced", ["certified", level(0.01617)]),
        ("claim false", [0.20162, "certified", "certified", 0.20162]),
        ("claim false", [0.67, 4.2603e-4]),
        ("reproduced", [0.91006]),
    ],
    ("chapter4", "simulations"): [
        ("not reproduced", [1.0, 1.0]),
        ("not reproduced", [1.0, 1.0]),
        ("reproduced", [0.17555, 0.13274]),
        ("reproduced", [-0.042666]),
        ("reproduced", [SMALL]),
    ],
    ("chapter5", "equations"): [
        ("reproduced", [SMALL]),
        ("reproduced", [SMALL]),
        ("reproduced", [220.23]),
        ("reproduced", [5.0, 3.0]),
        ("reproduced", [SMALL, 15.0]),
        ("reproduced", [3.0, SMALL]),
        ("claim false", [24.0, 1.0, 1.0, 4.0]),
        ("claim false", [1.0, 1.0, SMALL]),
        ("reproduced", [4.0, 1.0, 5.0, SMALL, SMALL]),
        ("reproduced", ["certified"]),
        ("reproduced", [0.68726]),
    ],
    ("chapter5", "history"): [
        ("reproduced", [1.8128]),
    ],
    ("chapter6", "identification"): [
        ("reproduced", [0.79473, 1.9849, "white"]),
    ],
    ("chapter6", "equations"): [
        ("reproduced", [1.0, 50.159]),
        ("reproduced", [SMALL, 0.15]),
        ("reproduced", [SMALL, 0.99944]),
        ("reproduced", [JUDGED, 0.15]),
        ("reproduced", [SMALL]),
        ("reproduced", [SMALL]),
        ("claim false", [7.0998e-05, "certifies", 845.1]),
        ("claim false", [0.002797, 0.002797]),
    ],
    ("chapter6", "mixed wall"): [
        ("reproduced", [SMALL]),
        ("claim false", [2.0, 2.0]),
        ("reproduced", [SMALL, 2.0]),
        ("not reproduced", [0.070462]),
        ("claim false", [6692.5, 6692.5]),
        ("reproduced", ["found"]),
    ],
    ("chapter6", "transparency"): [
        ("claim false", [SMALL, SMALL, 1718.6]),
        ("claim false", [2091.9, 2091.9, 1791.7, 925.56]),
        ("claim false", [4.5484, 4.5484]),
    ],
    ("chapter6", "slide"): [
        ("reproduced", [0.00062594, 2.33]),
        ("reproduced", [1.3856]),
        ("reproduced", [0.013893]),
    ],
    ("chapter7", "designs without the network"): [
        ("reproduced", [0.89773, 0.91654]),
        ("not reproduced", [-0.28702]),
        ("claim false", [1.05401, 1.05401, 0.97616]),
        ("claim false", [1.22174, 1.22174]),
        ("claim false", [0.31972, 0.31972, 0.5621]),
        ("reproduced", [0.122, 0.33903]),
    ],
    ("chapter7", "fit of the motor, Table 7.2, experiment"): [
        ("undecided", [0.5, 0.5]),
        ("undecided", [0.25, 0.5]),
        ("not reproduced", [0.75, 0.0]),
        ("undecided", [0.25]),
        ("undecided", [0.75]),
    ],
    ("chapter7", "models and statements"): [
        ("claim false", [1.00023, 1.8844e-5, 0.34868, 0.38408, 1.00023]),
        ("reproduced", [4.9757e-5]),
        ("reproduced", [1.00276, 0.002583, 1.00276, -0.002583, 0.99768, SMALL, 0.97949, SMALL]),
        ("claim false", [3.0, 3.0, 7.0, 1.0]),
        ("claim false", [3.73682, 0.75314, 16.0524]),
        ("reproduced", [20.0, 1.0]),
    ],
    ("chapter7", "Smith predictor"): [
        ("undecided", [-41.379, 1.701, 0.083881, -53.23, 1.3854, 0.099287,
                       -4.2718, -0.61643, -0.010869, -16.082, -0.93239, 0.0047917]),
        ("claim false", [-0.96266, -0.023082, -0.48227, -4.2718, -0.0077711]),
    ],
}
"""Of a stage: each row's verdict, and the values of its checks, of its witness and beside them."""

DRAWN: dict[tuple[str, str], list[tuple[str, str, str, int, float]]] = {
    ("chapter2", "settling times"): [
        ("Figure 2.2", "2.2a: x1(t), same switching instants", "(2.27)", 1001, 3.1333),
        ("Figure 2.2", "2.2a: x1(t), same switching instants", "[1, 2]", 1001, 4.5475),
        ("Figure 2.2", "2.2a: x2(t), same switching instants", "(2.27)", 1001, 7.6358),
        ("Figure 2.2", "2.2a: x2(t), same switching instants", "[1, 2]", 1001, 13.192),
        ("Figure 2.2", "2.2b: x1(t), 20 runs of (2.27)", "single runs", 1001, 3.7785),
        ("Figure 2.2", "2.2b: x2(t), 20 runs of (2.27)", "single runs", 1001, 8.6969),
        ("Figure 2.3", "2.3a: mean of x1, 60 runs", "(2.27)", 1001, 4.6118),
        ("Figure 2.3", "2.3a: mean of x1, 60 runs", "[1, 2]", 1001, 4.2272),
        ("Figure 2.3", "2.3a: mean of x2, 60 runs", "(2.27)", 1001, 9.2035),
        ("Figure 2.3", "2.3a: mean of x2, 60 runs", "[1, 2]", 1001, 12.432),
        ("Figure 2.3", "2.3b: settling time of (2.27)", "counts", 60, 191.15),
        ("Figure 2.3", "2.3b: settling time of [1, 2]", "counts", 60, 557.1),
        ("Figure 2.4", "2.4a: mean of the settling time", "(2.27)", 51, 10.09),
        ("Figure 2.4", "2.4a: mean of the settling time", "[1, 2]", 51, 83.016),
        ("Figure 2.4", "2.4b: standard deviation of the settling time", "(2.27)", 51, 0.78973),
        ("Figure 2.4", "2.4b: standard deviation of the settling time", "[1, 2]", 51, 4.2721),
    ],
    ("chapter2", "certified scales"): [
        ("What partitioning buys", "largest certified scale of the uncertainty", "linear in h (ours)", 4, 5.7125),
        ("What partitioning buys", "largest certified scale of the uncertainty", "constant per section (sound)", 4, 1.9625),
        ("What partitioning buys", "largest certified scale of the uncertainty", "printed (unsound)", 4, 11.463),
    ],
    ("chapter3", "sound levels"): [
        ("Figure 3.2", "3.2: x1", "printed gains", 1001, 6.8605),
        ("Figure 3.2", "3.2: x2", "printed gains", 1001, 3.815),
        ("Figure 3.2", "3.2: x3", "printed gains", 1001, 14.196),
        ("Figure 3.2", "3.2: x4", "printed gains", 1001, 3.5916),
        ("Levels", "certified gamma", "gamma", 4, 1.9219),
    ],
    ("chapter7", "what the actuator knows"): [
        ("What the actuator knows",
         "Best norm by what the gain may depend on, relative to one constant gain", "motor h2", 7, 0.86906),
    ],
    ("chapter7", "gain bounds"): [
        ("Norm against gain bound", "Smallest H-infinity norm of the VTOL", "z stacked", 1, 79.669),
        ("Norm against gain bound", "Smallest H-infinity norm of the VTOL", "z sum", 1, 79.669),
    ],
    ("chapter4", "gains that see r only"): [
        ("Gains that see r only", "(4.30) as K_kk", "single runs", 301, 8144700.0),
        ("Gains that see r only", "(4.31) as K_kk,m", "single runs", 301, 0.29932),
    ],
    ("chapter4", "lifetimes"): [
        ("Figures 4.1 and 4.2", "4.1: density of the lifetime", "one component", 400, 0.101),
        ("Figures 4.1 and 4.2", "4.1: density of the lifetime", "one of two", 400, 0.066482),
        ("Figures 4.1 and 4.2", "4.1: density of the lifetime", "one of three", 400, 0.05981),
        ("Figures 4.1 and 4.2", "4.1: density of the lifetime", "one and a cold spare", 400, 0.049738),
        ("Figures 4.1 and 4.2", "4.2: transition rate", "one component", 400, 1.0),
        ("Figures 4.1 and 4.2", "4.2: transition rate", "one of two", 400, 0.78474),
        ("Figures 4.1 and 4.2", "4.2: transition rate", "one of three", 400, 0.68608),
        ("Figures 4.1 and 4.2", "4.2: transition rate", "one and a cold spare", 400, 0.44971),
        ("Figure 4.3", "4.3: fault occurrence", "eta (fault)", 7, 2.7143),
        ("Figure 4.3", "4.3: fault occurrence", "r (detection)", 39, 2.5385),
    ],
    ("chapter4", "simulations"): [
        ("Figures 4.4 and 4.5", "x1", "(4.30), fault known", 301, 0.0074453),
        ("Figures 4.4 and 4.5", "x1", "(4.31), fault known", 301, 0.029552),
        ("Figures 4.4 and 4.5", "x2 = y", "(4.30), fault known", 301, 0.03497),
        ("Figures 4.4 and 4.5", "x2 = y", "(4.31), fault known", 301, 0.014789),
        ("Figures 4.4 and 4.5", "x3", "(4.30), fault known", 301, 0.43302),
        ("Figures 4.4 and 4.5", "x3", "(4.31), fault known", 301, 0.1919),
        ("Figures 4.4 and 4.5", "x4", "(4.30), fault known", 301, 0.020423),
        ("Figures 4.4 and 4.5", "x4", "(4.31), fault known", 301, 0.051738),
        ("Figures 4.6 and 4.7", "x1", "(4.30), fault known", 301, 0.006209),
        ("Figures 4.6 and 4.7", "x1", "(4.31), fault known", 301, 0.027908),
        ("Figures 4.6 and 4.7", "x2 = y", "(4.30), fault known", 301, 0.029906),
        ("Figures 4.6 and 4.7", "x2 = y", "(4.31), fault known", 301, 0.011643),
        ("Figures 4.6 and 4.7", "x3", "(4.30), fault known", 301, 0.42325),
        ("Figures 4.6 and 4.7", "x3", "(4.31), fault known", 301, 0.18937),
        ("Figures 4.6 and 4.7", "x4", "(4.30), fault known", 301, 0.017933),
        ("Figures 4.6 and 4.7", "x4", "(4.31), fault known", 301, 0.051308),
        ("Figure 4.8", "4.8: ||y|| / ||w|| per run", "(4.30), fault known", 40, 0.016972),
        ("Figure 4.8", "4.8: ||y|| / ||w|| per run", "(4.31), fault known", 40, 0.00696),
        ("Figure 4.8", "(4.30), fault known", "counts", 30, 5.2963),
        ("Figure 4.8", "(4.31), fault known", "counts", 30, 3.4162),
    ],
    ("chapter6", "slide"): [
        ("Figures 6.9 and 6.10", "6.9: depth of the avatar", "avatar", 397, 2.8595),
        ("Figures 6.9 and 6.10", "6.10: material under it", "material", 397, 5.7657),
    ],
    ("chapter7", "Figures 7.2 and 7.3"): [
        ("Figure 7.2: H2 controller of the VTOL", "Vertical velocity", "published gains, one run", 500, 1.0023),
        ("Figure 7.2: H2 controller of the VTOL", "Vertical velocity", "predicted mean ± 2 sd", 500, 0.012853),
        ("Figure 7.2: H2 controller of the VTOL", "Root mean square error", "published gains", 500, 0.0047787),
        ("Figure 7.2: H2 controller of the VTOL", "Root mean square error", "local gain: diverges", 60, 6949.0),
        ("Figure 7.3: H-infinity controller of the VTOL", "Vertical velocity", "published gains, one run", 500, 1.0018),
        ("Figure 7.3: H-infinity controller of the VTOL", "Vertical velocity", "predicted mean ± 2 sd", 500, 0.026086),
        ("Figure 7.3: H-infinity controller of the VTOL", "Root mean square error", "published gains", 500, 0.005033),
        ("Figure 7.3: H-infinity controller of the VTOL", "Root mean square error", "local gain: diverges", 60, 6949.0),
    ],
    ("chapter7", "fit of the motor, Table 7.2, experiment"): [
        ("Figure 7.6: H-infinity controller", "Motor angle", "simulation, T = 0.05 s", 1000, 8.8921),
        ("Figure 7.6: H-infinity controller", "Motor angle", "fitted motor, T = 0.05 s", 1000, 8.6348),
        ("Figure 7.6: H-infinity controller", "Motor angle", "simulation, T = 0.025 s", 2000, 8.8245),
        ("Figure 7.6: H-infinity controller", "Motor angle", "predicted mean ± 2 sd, T = 0.05 s", 1000, 0.047325),
        ("Figure 7.7: H2 controller", "Motor angle", "simulation, T = 0.05 s", 1000, 8.89),
        ("Figure 7.7: H2 controller", "Motor angle", "fitted motor, T = 0.05 s", 1000, 8.712),
        ("Figure 7.7: H2 controller", "Motor angle", "simulation, T = 0.025 s", 2000, 8.8327),
        ("Figure 7.7: H2 controller", "Motor angle", "predicted mean ± 2 sd, T = 0.05 s", 1000, 0.055866),
        ("Figure 7.8: local controller", "Motor angle", "simulation, T = 0.05 s", 136, 29.033),
        ("Figure 7.8: local controller", "Motor angle", "fitted motor, T = 0.05 s", 1000, 8.6256),
        ("Figure 7.8: local controller", "Motor angle", "simulation, T = 0.025 s", 2000, 8.8894),
        ("Figure 7.8: local controller", "Motor angle", "predicted mean ± 2 sd, T = 0.025 s", 2000, 0.056734),
    ],
    ("chapter7", "Smith predictor"): [
        ("Figure 7.4: Smith predictor", "Motor angle", "H-infinity (7.36)", 1000, 8.8921),
        ("Figure 7.4: Smith predictor", "Motor angle", "H2 (7.37)", 1000, 8.89),
        ("Figure 7.4: Smith predictor", "Motor angle", "Smith, -0.03", 1000, 8.7086),
        ("Figure 7.4: Smith predictor", "Motor angle", "Smith, -0.16", 1000, 8.8303),
    ],
}
"""Of a stage: plot, panel, line or band, its points, and the mean square of the line or of the width of the band."""

VALUES: dict[tuple[str, str], dict[str, Any]] = {
    ("chapter2", "a Markov approximation"): {
        "markov[0]": 0.66457, "semi[0]": 0.8979, "stay": 1.2472,
    },
    ("chapter2", "certified scales"): {
        "least[printed]": 0.032258, "least[pwc]": 0.090909, "least[pwl]": 0.047619, "line[printed]": "3.10, 3.20, 3.40, 3.80",
        "line[pwc]": "1.10, 1.20, 1.40, 1.80", "line[pwl]": "2.10, 2.20, 2.40, 2.80",
    },
    ("chapter2", "partition strategies"): {
        "pwc[scales][0]": 2.1519, "pwc[scales][1]": 2.55, "pwc[scales][2]": 2.625, "pwc[role]": 1.2198,
        "pwl[scales][0]": 3.1519, "pwl[scales][1]": 3.55, "pwl[scales][2]": 3.625, "pwl[role]": 1.1501, "sections[0]": 4,
        "sections[1]": 4, "sections[2]": 4,
    },
    ("chapter3", "sound levels"): {
        "unforced": 0.977, "published.gamma": 0.1, "ramp": 0.5, "norm": 5.0776, "whole[0]": 5.0, "whole[1]": 1.5,
        "halves[0]": 2.5, "halves[1]": 0.75, "gain[0]": 2.0, "gain[1]": 2.0, "frozen": 0.42322,
        "made": "gain norm <= 5: gamma 2.5000; gain norm <= 1.5: gamma 0.7500",
    },
    ("chapter7", "designs"): {
        "motor_h2_sum[norm]": 3.7055, "motor_h2_sum[gains][0][0][0][0]": -0.2324, "motor_h2_sum[gains][0][1][0][0]": -0.18706,
        "motor_h2_sum[largest]": 0.2324, "motor_h2_sum[off]": 0.091442, "motor_h2_sum[each][0][0]": 0.034397,
        "motor_h2_sum[each][0][1]": 0.022357, "motor_h2_stacked[norm]": 3.7109, "motor_h2[norm]": 3.7368,
        "motor_h2[rounding]": 8.0343e-05, "motor_h2[size]": 0.198, "motor_h2[least]": 0.99161, "wrong": 8.105,
    },
    ("chapter7", "what the actuator knows"): {
        "motor_h2[constant]": 3.8912, "motor_h2[tau]": 3.7432, "motor_h2[previous]": 3.7386, "motor_h2[generated]": 3.7109,
        "motor_h2[total]": 3.5123, "motor_h2[applied]": 3.4696, "motor_h2[both]": 3.2916, "motor_h2[gained]": 0.065024,
        "motor_h2[before]": -0.0073959, "motor_h2[one]": -0.046326,
    },
    ("chapter7", "gain bounds"): {},
}
"""Of a stage of which so much is left out that its rows cannot be judged: numbers by name."""
# fmt: on


def scale(system: JumpSystem, request: Synthesis, *, tolerance: float) -> tuple[float, None]:
    """A largest scale of no search: by the form, the number of sections and where the second of given ones begins."""
    form = 3.0 if isinstance(request, PrintedRequest) else {"pwc": 1.0, "pwl": 2.0}[request.method]
    cut = request.sections
    return form + (0.1 * cut if isinstance(cut, int) else 0.1 * len(cut[0]) + cut[0][1]), None


def certificate(system: DelayedJumpSystem, *given: Any, **more: Any) -> JumpCertificate:
    """A level of no search: by the bound and the sections, or by the nodes."""
    gamma = more["gain_bound"] / len(more["sections"][0]) if "sections" in more else 0.1 * len(more.get("nodes", [[0.0]])[0])
    return JumpCertificate(method="pwc", verdict="certified", reason="", gamma=gamma, gain=chapter3_gain())


SMALLER: dict[str, Any] = {
    "chapter2_runs.RUNS": 60, "chapter2_feasibility.BOUNDS": (5.0,), "chapter2.largest_uncertainty": scale,
    "chapter3.delayed_hinf": certificate, "chapter3.analyse_delayed": certificate,
    "chapter3.delayed_runs": partial(delayed_runs, step_s=0.02), "chapter4_simulations.RUNS": 40,
    "chapter7_friction.FIT_SEEDS": 2, "chapter7_friction.CANDIDATES": 7, "chapter7_friction.CHECK_SEEDS": 3,
    "chapter7_runs.Workers": lambda **_: Workers(), "chapter7_designs.TrackingProblem": partial(TrackingProblem, starts=1),
    "chapter7_designs.PROBLEMS": (("motor", "h2"),), "chapter7_designs.SERIES": (("motor", "h2"),),
    "chapter7_designs.GAINS": {("motor", "h2"): H2}, "chapter7_designs.BOUNDS": (0.5,),
}  # fmt: skip
"""What takes minutes with the numbers of `hil reproduce`: few runs and problems, one start of a descent, in this process."""

FEW = {("chapter2", "settling times"), ("chapter7", "fit of the motor, Table 7.2, experiment")}
"""By so few runs that many a check is undecided."""


@pytest.mark.parametrize(("chapter", "title"), sorted({*ROWS, *DRAWN, *VALUES}))
def test_a_stage_computes_what_it_did(chapter: str, title: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in SMALLER.items():
        monkeypatch.setattr(f"hil.thesis.{name}", value)
    stages = importlib.import_module(f"hil.thesis.{chapter}").CHAPTER.stages
    (stage,) = (stage for stage in stages if stage.title == title)
    steps: list[tuple[int, int]] = []
    values = stage.compute(lambda text, done=0, total=0, /: steps.append((done, total)))
    rows = () if (chapter, title) in VALUES else judge(stage.statements, values)
    for name, number in VALUES.get((chapter, title), {}).items():
        assert named(values, name) == (pytest.approx(number, rel=1e-3) if isinstance(number, float) else number), name
    found = [(row.verdict, [check.value for check in (*row.checks, *row.witness, *row.beside)]) for row in rows]
    assert [verdict for verdict, _ in found] == [verdict for verdict, _ in ROWS.get((chapter, title), [])]
    for (_, values_of), (_, expected) in zip(found, ROWS.get((chapter, title), [])):
        for value, is_to_be in zip(values_of, expected, strict=True):
            if is_to_be is not JUDGED:
                assert value == (pytest.approx(is_to_be, rel=1e-3, abs=3e-8) if isinstance(is_to_be, float) else is_to_be)
    if (chapter, title) not in FEW:
        assert_every_number_decides(rows)
    counted = [step for step in steps if step[1]]
    assert counted == sorted(counted) and all(done <= total for done, total in counted)
    if (chapter, title) in DRAWN:
        shown = drawn(values)
        assert [tuple(line[:4]) for line in shown] == [line[:4] for line in DRAWN[chapter, title]]
        assert [line[4] for line in shown] == pytest.approx([line[4] for line in DRAWN[chapter, title]], rel=1e-3)


def drawn(values: dict[str, Any]) -> list[tuple[str, str, str, int, float]]:
    """Return what a stage draws of known gains; those that it designs itself are left out. Lines of one name are one."""
    found: dict[tuple[str, str, str, int], list[float]] = {}
    for plot in values["figures"]:
        for panel in plot.panels:
            lines = []
            if isinstance(panel, Bars):
                lines = [(group.label, np.asarray(group.values)) for group in panel.groups]
            elif isinstance(panel, Histogram):
                found[plot.title, panel.title, "counts", len(panel.counts)] = [float(np.dot(panel.counts, panel.edges[1:]))]
            elif isinstance(panel, Figure):
                lines = [(line.label, np.asarray(line.y)) for line in panel.series]
                lines += [(band.label, np.asarray(band.upper) - np.asarray(band.lower)) for band in panel.bands]
            for label, y in lines:
                found.setdefault((plot.title, panel.title, label, len(y)), []).append(float(np.square(y).mean()))
    known = {line: size for line, size in found.items() if not any(words.startswith("ours") for words in line[1:3])}
    return [(*line, float(np.mean(size))) for line, size in known.items()]
