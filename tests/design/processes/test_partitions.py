"""Partitions (2.22)-(2.24): each strategy does what its equation says."""

from __future__ import annotations

import numpy as np
import pytest

from design.processes.partitions import check_partition, equal_probability, rate_threshold, uniform
from design.processes.rates import WeibullRate, clip_rate, constant_rate
from design.processes.semi_markov import SemiMarkov

RAMP = clip_rate(0.1, 4.6)
PROCESS = SemiMarkov(rates=((None, RAMP), (RAMP, None)))


def test_sections_of_equal_probability_end_equally_often() -> None:
    for sections in (1, 2, 5, 8):
        starts = equal_probability(PROCESS, sections)
        check_partition(PROCESS, starts)
        ends = 1 - np.exp(-PROCESS.integral(0, np.append(starts[0], np.inf)))
        assert np.diff(ends) == pytest.approx(1 / sections)


def test_median_of_the_clipped_ramp_is_not_the_printed_section_boundary() -> None:
    # 0.8326 is the median of the hazard 2h; the printed rate (2.26) has its median at 1.1732
    assert equal_probability(PROCESS, 2)[0][1] == pytest.approx(1.1732, abs=1e-4)


def test_uniform_sections_have_equal_length() -> None:
    assert uniform(PROCESS, 4)[1] == pytest.approx((0.0, 1.15, 2.3, 3.45))
    assert uniform(PROCESS, 2, end_s=3.0)[0] == pytest.approx((0.0, 1.5))
    assert uniform(SemiMarkov(rates=((None, constant_rate(1.0)), (RAMP, None))), 2)[0] == (0.0,)


def test_no_rate_changes_by_more_than_the_threshold_in_a_section_and_none_could_be_longer() -> None:
    """The ramp from 0.1 to 4.6 in four steps: it starts at 0.1 s, so that the first section is longer than the others."""
    starts = rate_threshold(PROCESS, 4.5 / 4)
    check_partition(PROCESS, starts)
    assert starts[0] == pytest.approx((0.0, 1.225, 2.35, 3.475)) and starts[1] == starts[0]
    assert rate_threshold(PROCESS, 4.5)[0] == (0.0,) and len(rate_threshold(PROCESS, 0.11)[0]) == 41
    for start, stop in zip(starts[0], (*starts[0][1:], 10.0)):
        low, high = PROCESS.bounds(0, start, stop)
        assert (high - low <= 4.5 / 4).all()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: rate_threshold(PROCESS, 0.0), "threshold: 0.0"),
        (lambda: rate_threshold(PROCESS, 1e-3, most=10), "threshold: 0.001: mode 0 takes more than 10 sections"),
        (lambda: equal_probability(PROCESS, 0), "sections: 0"),
        (
            lambda: uniform(SemiMarkov(rates=((None, WeibullRate(scale_s=1.0, shape=2.0)), (RAMP, None))), 2),
            "end_s: the",
        ),
        (lambda: check_partition(PROCESS, ((0.0,),)), "partition: 1 tuples"),
        (lambda: check_partition(PROCESS, ((0.0, 2.0, 1.0), (0.0,))), r"partition\[0\]: \(0.0, 2.0, 1.0\)"),
    ],
)
def test_bad_partition_is_refused(call: object, message: str) -> None:
    with pytest.raises(ValueError, match="^" + message):
        call()  # type: ignore[operator]
