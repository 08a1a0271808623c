"""Section 3.3: boxes of matrices, and the rows on partitions."""

from __future__ import annotations

import itertools
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from design.as_printed.chapters_2_to_4 import inequality_at
from design.as_printed.examples import chapter3_gain, chapter3_process, chapter3_system
from design.semi_markov_loop.certificate import JumpCertificate
from hil.thesis import chapter3_partitions as section
from hil.thesis.chapter3_partitions import FURTHER, PARTITIONS, further, interval_matrices, partitions, rates_inside
from hil.thesis.statements import judge
from tests.hil.thesis.judging import assert_every_number_decides


def test_all_corners_decide_of_a_box_and_two_do_not() -> None:
    assert interval_matrices("all", seed=1) == pytest.approx(-0.01, abs=0.01)
    assert interval_matrices("all", seed=1) < 0.0 < interval_matrices("two", seed=1)


def _quiet(text: str, done: int = 0, total: int = 0, /) -> None:
    pass


def test_the_inequality_is_largest_at_a_corner_of_the_rates_of_a_mode() -> None:
    """(3.41) at matrices of no proof: points inside lie below the largest corner, near to it where there are many."""
    rng, system, process = np.random.default_rng(4), chapter3_system(), chapter3_process()
    matrices = {f"X[{i}]": (s := rng.normal(size=(4, 4))) @ s.T + np.eye(4) for i in range(3)}
    matrices |= {f"U[{i}]": rng.normal(size=(2, 4)) for i in range(3)} | {"Q": 3.0 * np.eye(4)}
    found = JumpCertificate(method="printed", verdict="certified", reason="", gamma=0.8, matrices=matrices)
    at_corners, inside = rates_inside(found)
    bounds = [process.bounds(i, 0.0, np.inf) for i in range(3)]
    totals = [max(float(side.sum()) for side in sides) for sides in zip(*bounds)]
    largest = []
    for i, (low, high) in enumerate(bounds):
        for corner, eta in itertools.product(itertools.product(*zip(low, high)), totals):
            rates = [0.0 if j == i else rate for j, rate in enumerate(corner)]
            largest.append(float(np.linalg.eigvalsh(inequality_at(system, found, i, rates, eta))[-1]))
    assert at_corners == pytest.approx(max(largest)) and len({*np.round(largest, 6)}) > 12
    assert 0.7 * (at_corners - min(largest)) < inside - min(largest) < at_corners - min(largest)


def test_numbers_of_section_3_3_are_of_what_was_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """With levels and eigenvalues in the place of minutes of search; decay, runs and boxes are computed."""
    asked, said = [], []

    def delayed_section(*given: Any, **more: Any) -> SimpleNamespace:
        asked.append((given[2:], more))
        return SimpleNamespace(gamma={section.WHOLE: 2.0, section.SECTIONS: (1.0, 1.6)[given[3]]}[given[2]])

    for name, answer in (
        ("delayed_section", delayed_section), ("rates_inside", lambda found: (-0.5, -0.7 * found.gamma)), ("BOXES", 20),
        ("RUNS", 10),
    ):  # fmt: skip
        monkeypatch.setattr(section, name, answer)
    values = partitions(lambda text, done=0, total=0, /: said.append((done, total)))
    assert said == [(0, 4), (1, 4), (2, 4), (3, 4)]
    parts = ((section.WHOLE, 0), (section.SECTIONS, 0), (section.SECTIONS, 1))
    bounded = [(part, bound) for bound in section.BOUNDS for part in parts]
    assert [(given[:2], more["gain_bound"]) for given, more in asked] == bounded
    assert all(given[2] is None and more["reading"] == "consistent" for given, more in asked)
    assert values["levels"] == {"one": [2.0, 2.0], "two": [1.6, 1.6]} and values["less"] == [1.25, 1.25]
    assert (values["corners"], values["inside"]) == (-0.5, -1.4) and {*values["boxes"]} == {"all", "two"}
    assert values["rate"] > 0.0 and values["sigma"] > 1.0 and values["over"] < 1.0 <= values["peak"] < values["sigma"]
    rows = judge(PARTITIONS, values)
    assert [row.verdict for row in rows] == ["reproduced"] * 4
    assert_every_number_decides(rows)


def test_longer_delays_are_judged_one_after_the_other_and_gains_beside_the_printed_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """With a level that is the largest delay and 10 slopes, and gains that are the printed ones but for one entry."""
    printed, off = chapter3_gain(), 3e-5
    X = np.diag([1.0, 2.0, 3.0, 4.0])

    def delayed_section(system: Any, process: Any, sections: Any, m: int, gain: Any, **more: Any) -> JumpCertificate:
        assert sections == section.SECTIONS and more["gain_bound"] == section.BOUNDS[0] and more["gamma"] == section.GAMMA
        K = printed.gain[:, m] + off * (m == 1)
        matrices = {f"X[{i}]": X for i in range(3)} | {f"U[{i}]": K[i] @ X for i in range(3)}
        return JumpCertificate(method="printed", verdict="certified", reason="", matrices=matrices)

    def analysed(system: Any, gain: Any, process: Any) -> JumpCertificate:
        assert gain is printed or (gain.gain == printed.gain).all()
        level = system.delay_max_s + 10.0 * system.delay_slopes.max()
        return JumpCertificate(method="pwc", verdict="certified", reason="", gamma=level)

    monkeypatch.setattr(section, "delayed_section", delayed_section)
    monkeypatch.setattr(section, "analyse_delayed", analysed)
    said: list[tuple[str, int, int]] = []
    values = further(lambda text, done=0, total=0, /: said.append((text, done, total)))
    assert [(done, total) for _, done, total in said] == [(n, 11) for n in range(11)]
    assert (said[6][0], said[7][0]) == ("delays up to 2 s", "slope 0")
    steepest = 10.0 * chapter3_system().delay_slopes.max()
    assert values["delays"] == pytest.approx([delay + steepest for delay in section.DELAYS_S])
    assert values["slopes"] == pytest.approx([chapter3_system().delay_max_s + 10.0 * slope for slope in section.SLOPES])
    assert values["rise"] == pytest.approx({"delays": 0.1, "slopes": 3.0}) and values["off"] == pytest.approx(off)
    assert values["size"] == np.abs(printed.gain).max()
    assert values["first"] == "; ".join(" ".join(f"{entry:.4f}" for entry in row) for row in printed.gain[0, 0])
    (panel,) = values["figures"][0].panels
    assert [*panel.series[0].x] == [*section.DELAYS_S] and [*panel.series[0].y] == values["delays"]
    assert [row.verdict for row in judge(FURTHER, values)] == ["reproduced"] * 2
    assert_every_number_decides(judge(FURTHER, values))
    fewer = [delayed_section(None, None, section.SECTIONS, m, None, gain_bound=5.0, gamma=0.93) for m in (0, 1)]
    refused = iter([fewer[0], JumpCertificate(method="printed", verdict="refused", reason="")])
    monkeypatch.setattr(section, "delayed_section", lambda *given, **more: next(refused))
    assert math.isnan(further(_quiet)["off"])


@pytest.mark.slow
def test_rows_of_section_3_3_hold_and_turn() -> None:
    values: dict[str, Any] = dict(partitions(_quiet))
    rows = judge(PARTITIONS, values)
    assert [row.verdict for row in rows] == ["reproduced"] * 4
    assert_every_number_decides(rows)
