"""The printed examples, as data: what their numbers have in common holds for each of them."""

from __future__ import annotations

import numpy as np

from design.as_printed.examples import chapter4_rate_knots


def test_mean_times_of_4_28_lie_on_lines_to_the_three_digits_that_are_printed() -> None:
    """Rates are 1 / (mean time), and the mean times at start, boundary and end of the sections are equally far apart."""
    failure, detection = chapter4_rate_knots()
    for knots in (failure, *detection):
        off_diagonal = knots[:, [0, 1], [1, 0]]
        start, middle, end = 1.0 / off_diagonal
        rounding = 0.0005 * (1.0 / off_diagonal**2).max(axis=0)
        assert (np.abs(start - 2.0 * middle + end) <= 4.0 * rounding).all()
