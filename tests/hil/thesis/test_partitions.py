"""Section 3.3: boxes of matrices, and the rows on partitions."""

from __future__ import annotations

import math
from typing import Any

import pytest

from hil.thesis.chapter3.partitions import PARTITIONS, interval_matrices, partitions
from hil.thesis.statements import judge
from tests.hil.thesis.judging import assert_every_number_decides


def test_all_corners_decide_of_a_box_and_two_do_not() -> None:
    assert interval_matrices("all", seed=1) == pytest.approx(-0.01, abs=0.01)
    assert interval_matrices("all", seed=1) < 0.0 < interval_matrices("two", seed=1)


FOUND: dict[str, Any] = {
    "boxes": {"all": -1e-9, "two": 0.5}, "corners": -1e-9, "inside": -1e-9, "rate": 1e-9, "sigma": 1.001, "peak": 1.5,
    "over": 0.999, "levels": {"one": [2.0, 2.0], "two": [1.0, 1.0]}, "less": [1.011, 1.011],
}  # fmt: skip


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("boxes", {"all": 1e-9, "two": 0.5}), ("corners", 1e-9), ("inside", 1e-9), ("rate", -1e-9), ("sigma", 0.999),
        ("over", 1.001), ("less", [1.011, 1.009]), ("less", [1.009, 1.011]),
    ],
)  # fmt: skip
def test_each_number_of_section_3_3_decides_at_the_sign_or_share_that_is_meant(name: str, wrong: Any) -> None:
    assert [row.verdict for row in judge(PARTITIONS, FOUND)] == ["reproduced"] * 4
    assert [row.verdict for row in judge(PARTITIONS, FOUND | {name: wrong})].count("reproduced") == 3


def _quiet(text: str, done: int = 0, total: int = 0, /) -> None:
    pass


@pytest.mark.slow
def test_rows_of_section_3_3_hold_and_turn() -> None:
    values: dict[str, Any] = dict(partitions(_quiet))
    rows = judge(PARTITIONS, values)
    assert [row.verdict for row in rows] == ["reproduced"] * 4
    assert_every_number_decides(rows)
    for name, wrong in (("inside", 1e-3), ("corners", math.nan), ("over", 1.1), ("rate", 0.0), ("less", [1.2, 1.0])):
        verdicts = [row.verdict for row in judge(PARTITIONS, values | {name: wrong})]
        assert sum(verdict != "reproduced" for verdict in verdicts) == 1, name
