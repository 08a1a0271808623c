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

from hil.pages.html.figures import Figure
from hil.thesis import chapter4_simulations as chapter4
from hil.thesis.statements import judge
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
    ("chapter7", "Smith predictor"): [
        ("Figure 7.4: Smith predictor", "Motor angle", "H-infinity (7.36)", 1000, 8.8921),
        ("Figure 7.4: Smith predictor", "Motor angle", "H2 (7.37)", 1000, 8.89),
        ("Figure 7.4: Smith predictor", "Motor angle", "Smith, -0.03", 1000, 8.7086),
        ("Figure 7.4: Smith predictor", "Motor angle", "Smith, -0.16", 1000, 8.8303),
    ],
}
"""Of a stage: plot, panel, line or band, its points, and the mean square of the line or of the width of the band."""
# fmt: on


@pytest.fixture
def fewer_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    """40 runs of the example of Chapter 4."""
    simulate = chapter4.simulate
    monkeypatch.setattr(chapter4, "RUNS", 40)
    monkeypatch.setattr(chapter4, "simulate", lambda gain, runs=40, **more: simulate(gain, runs, **more))


@pytest.mark.usefixtures("fewer_runs")
@pytest.mark.parametrize(("chapter", "title"), sorted({*ROWS, *DRAWN}))
def test_a_stage_computes_what_it_did(chapter: str, title: str) -> None:
    stages = importlib.import_module(f"hil.thesis.{chapter}").CHAPTER.stages
    (stage,) = (stage for stage in stages if stage.title == title)
    steps: list[tuple[int, int]] = []
    values = stage.compute(lambda text, done=0, total=0, /: steps.append((done, total)))
    rows = judge(stage.statements, values)
    found = [(row.verdict, [check.value for check in (*row.checks, *row.witness, *row.beside)]) for row in rows]
    assert [verdict for verdict, _ in found] == [verdict for verdict, _ in ROWS.get((chapter, title), [])]
    for (_, values_of), (_, expected) in zip(found, ROWS.get((chapter, title), [])):
        for value, is_to_be in zip(values_of, expected, strict=True):
            if is_to_be is not JUDGED:
                assert value == (pytest.approx(is_to_be, rel=1e-3, abs=3e-8) if isinstance(is_to_be, float) else is_to_be)
    assert_every_number_decides(rows)
    assert steps == sorted(steps) and all(done <= total for done, total in steps if total)
    if (chapter, title) in DRAWN:
        shown = drawn(values)
        assert [tuple(line[:4]) for line in shown] == [line[:4] for line in DRAWN[chapter, title]]
        assert [line[4] for line in shown] == pytest.approx([line[4] for line in DRAWN[chapter, title]], rel=1e-3)


def drawn(values: dict[str, Any]) -> list[tuple[str, str, str, int, float]]:
    """Return what a stage draws of known gains; those that it designs itself are left out."""
    found = []
    for plot in values["figures"]:
        for panel in plot.panels:
            if isinstance(panel, Figure):
                lines = [(line.label, np.asarray(line.y)) for line in panel.series]
                lines += [(band.label, np.asarray(band.upper) - np.asarray(band.lower)) for band in panel.bands]
                found += [(plot.title, panel.title, label, len(y), float(np.square(y).mean())) for label, y in lines]
    return [line for line in found if not line[2].startswith("ours")]
