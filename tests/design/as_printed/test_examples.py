"""The printed examples, as data: what their numbers have in common holds for each of them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import design.as_printed as examples
from design.as_printed import chapter2_system, chapter4_process, chapter4_rate_knots, chapter4_seen_gain
from design.as_printed.chapters_5_and_6 import historical_gains, newest_gains


def numbers(x: Any) -> list[float]:
    """Every number of an example, in order."""
    if hasattr(x, "__dataclass_fields__"):
        x = [getattr(x, name) for name in x.__dataclass_fields__]
    if isinstance(x, np.ndarray | tuple | list):
        return [number for each in x for number in numbers(each)]
    return [float(x)] if isinstance(x, int | float) else []


PRINTED = [
    ("(2.25)", chapter2_system("printed"), 32, 7.0315, 106.19),
    ("(2.25) as A_1(t) is printed", chapter2_system("matched"), 32, 7.3315, 116.59),
    ("vertices of (2.25)", chapter2_system(), 36, 2.4315, 32.39),
    ("(2.25) without uncertainty", chapter2_system("none"), 12, 2.4315, 25.59),
    ("(2.27)", examples.chapter2_gain(), 12, -9.2794, 32.6504),
    ("methods of [1, 2]", examples.chapter2_reference_gain(), 6, -2.0772, 0.3563),
    ("Section 3.4", examples.chapter3_system(), 160, -37.83726, -3363.06506),
    ("gains of Section 3.4", examples.chapter3_gain(), 54, 8.5864, 388.2244),
    ("Section 4.4", examples.chapter4_system(), 72, -14.7811, -381.1429),
    ("(4.28)", chapter4_rate_knots(), 36, 29.655, 731.588),
    ("(4.30)", examples.chapter4_gain(), 32, -61.0487, -250.8693),
    ("(4.31)", examples.chapter4_partitioned_gain(), 64, 41.4699, 245.1867),
    ("K_kk of (4.30)", chapter4_seen_gain(partitioned=False), 18, -65.0873, -141.1646),
    ("K_kk of (4.31)", chapter4_seen_gain(partitioned=True), 36, 41.9311, 359.1162),
    ("(5.16)", historical_gains(), 96, -0.8058, -31.8116),
    ("(5.17)", newest_gains(), 16, 0.3844, 21.1714),
]


@pytest.mark.parametrize(("name", "example", "count", "total", "weighted"), PRINTED, ids=[each[0] for each in PRINTED])
def test_no_printed_number_is_another_one(name: str, example: Any, count: int, total: float, weighted: float) -> None:
    """Their sum, and the sum of each times its place, as they were when all were compared with the page."""
    found = numbers(example)
    assert len(found) == count
    assert math.fsum(found) == pytest.approx(total, abs=1e-9)
    assert math.fsum(k * x for k, x in enumerate(found, start=1)) == pytest.approx(weighted, abs=1e-8)


def test_rates_meet_the_printed_bounds_at_the_ends_of_their_sections() -> None:
    lower, upper = examples.chapter3_rate_bounds()
    rates = examples.chapter3_process().rates
    for i, j in ((i, j) for i in range(3) for j in range(3) if i != j):
        assert rates[i][j]([0.0, 1.8, 3.6, 9.0]).tolist() == [lower[0, i, j], upper[0, i, j], upper[1, i, j], upper[1, i, j]]  # type: ignore[misc]
    assert np.array_equal(lower[1], upper[0])
    process, (failure, detection) = chapter4_process(failure_restarts_detection_clock=True), chapter4_rate_knots()
    assert process.failure_restarts_detection_clock
    for own, knots, end in ((process.failure, failure, 1.0), *zip(process.detection, detection, (0.3, 0.3))):
        for i, j in ((0, 1), (1, 0)):
            assert own.rates[i][j]([0.0, end, 2 * end, 9.0]).tolist() == pytest.approx([*knots[:, i, j], knots[2, i, j]])  # type: ignore[misc]
    (_, other), (back, _) = examples.chapter2_process().rates
    assert other([0.05, 2.0, 5.0]).tolist() == back([0.05, 2.0, 5.0]).tolist() == [0.1, 2.0, 4.6]  # type: ignore[misc]


def test_mean_times_of_4_28_lie_on_lines_to_the_three_digits_that_are_printed() -> None:
    """Rates are 1 / (mean time), and the mean times at start, boundary and end of the sections are equally far apart."""
    failure, detection = chapter4_rate_knots()
    for knots in (failure, *detection):
        off_diagonal = knots[:, [0, 1], [1, 0]]
        start, middle, end = 1.0 / off_diagonal
        rounding = 0.0005 * (1.0 / off_diagonal**2).max(axis=0)
        assert (np.abs(start - 2.0 * middle + end) <= 4.0 * rounding).all()
