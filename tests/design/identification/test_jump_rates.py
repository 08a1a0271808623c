"""How often a fault comes and goes, and how fast it is detected (4.2), from the modes that a log holds."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from design.errors import DesignError, FieldError
from design.identification.jump_rates import ModeRecord, jump_rates
from plants.parts.semi_markov import TransitionRates
from plants.vtol_fault import FaultyVTOL

FAILURE, DETECTION = (0.4, 0.3), ((1.0, 2.0), (3.0, 0.5))


def rates(*nodes: tuple[float, float], at: tuple[float, ...] = (0.0,)) -> TransitionRates:
    return TransitionRates(nodes_s=at, rates=tuple(((-out, out), (back, -back)) for out, back in nodes))


PLANT = FaultyVTOL(noise_std=0.0, failure=rates(FAILURE), detection=tuple(rates(each) for each in DETECTION))
TRUTH = {
    (None, 1, 2): 0.4, (None, 2, 1): 0.3, (1, 1, 2): 1.0, (1, 2, 1): 2.0, (2, 1, 2): 3.0, (2, 2, 1): 0.5,
}  # fmt: skip


def recorded(plant: FaultyVTOL, seed: int, slots: int, period_s: float = 0.01) -> ModeRecord:
    run, modes = plant.start(np.random.default_rng(seed)), []
    for _ in range(slots):
        modes.append(run.state[-2:])
        run.advance(round(period_s * 1e9), (0.0, 0.0))
    fault, detected = np.array(modes, dtype=np.int64).T
    return ModeRecord(fault, detected, period_s)


def test_intervals_hold_the_truth_in_95_of_100_logs_and_seldom_its_double() -> None:
    """120 logs of 40 s, 720 intervals: a coverage of 0.955 to 0.977 fails the bounds in 1 of 40 choices of the seeds or fewer."""
    inside, above = Counter[object](), Counter[object]()
    for seed in range(120):
        for each in jump_rates([recorded(PLANT, seed, 2000, 0.02)]):
            truth = TRUTH[each.fault, each.source, each.to]
            inside[each[:3]] += each.low <= truth <= each.high
            above[each[:3]] += each.low <= 2.0 * truth <= each.high
    assert 0.94 <= sum(inside.values()) / 720 <= 0.99 and min(inside.values()) >= 106
    assert sum(above.values()) < 0.5 * 720


def stays(rng: np.random.Generator, rates: np.ndarray, slots: int) -> ModeRecord:
    """A process of two modes or more, each left to the next, seen at samples 1 s apart."""
    modes = np.arange(6 * slots) % len(rates)
    ends = np.cumsum(rng.exponential(1.0 / rates[modes]))
    fault = modes[np.searchsorted(ends, np.arange(slots), side="right")] + 1
    return ModeRecord(fault, np.ones(slots, dtype=np.int64), 1.0)


def test_stays_that_no_sample_falls_into_are_within_the_interval() -> None:
    """A tenth of the jumps is hidden, and a rate of 0 seen as 0.003: of right bounds more than 4 of 40 miss once in 100."""
    for rates in (np.array([0.1, 0.1]), np.array([0.06, 0.08, 0.05])):
        missed = Counter[object]()
        for seed in range(40):
            for each in jump_rates([stays(np.random.default_rng(seed), rates, 20_000)]):
                truth = rates[each.source - 1] if each.to == each.source % len(rates) + 1 else 0.0
                missed[each[:3]] += each.fault is None and not each.low <= truth <= each.high
        assert max(missed.values()) <= 4, missed


def test_stays_that_no_sample_falls_into_are_the_short_ones() -> None:
    """Of the true mode: 0.05 out of mode 1, out of mode 2 0.08 up to a stay of 10 samples and then 0.03.

    Of 25 right bounds of a rate more than 3 miss in 1 of 250 choices of the seeds; by the mean rates 6 do.
    """
    missed: Counter[object] = Counter()
    for seed in range(25):
        rng = np.random.default_rng(seed)
        first, used = rng.exponential(20.0, 4000), rng.exponential(1.0, 4000)
        second = np.where(used < 0.8, used / 0.08, 10.0 + (used - 0.8) / 0.03)
        ends = np.cumsum(np.stack([first, second], axis=1).ravel())
        fault = 1 + np.searchsorted(ends, np.arange(100_000.0), side="right") % 2
        for each in jump_rates([ModeRecord(fault, np.ones_like(fault), 1.0)], (10.0,)):
            if each.fault is None:
                truth = 0.05 if each.source == 1 else 0.03 if each.after_s else 0.08
                missed[each[1:4]] += not each.low <= truth <= each.high
    assert max(missed.values()) <= 3, missed


def test_several_logs_are_one_record_with_a_narrower_interval() -> None:
    one, many = (jump_rates([recorded(PLANT, seed, 2000) for seed in range(count)]) for count in (1, 9))
    width = [each.high - each.low for each in (one[0], many[0])]
    assert width[1] < 0.6 * width[0] and many[0].exposure_s > 5.0 * one[0].exposure_s


def test_rates_that_change_with_the_sojourn_are_found_between_the_edges() -> None:
    """Slow below 0.5 s, fast above: of 300 s in all."""
    steep = rates((0.2, 0.2), (0.2, 0.2), (2.0, 2.0), at=(0.0, 0.5, 0.501))
    plant = FaultyVTOL(noise_std=0.0, failure=rates((1e-6, 1e-6)), detection=(steep, steep))
    found = {(each.source, each.after_s): each for each in jump_rates([recorded(plant, 3, 30_000)], (0.5,)) if each.fault == 1}
    for source in (1, 2):
        slow, fast = found[source, 0.0], found[source, 0.5]
        assert slow.low < 0.2 < slow.high < 1.0 and fast.low < 2.0 < fast.high and fast.low > 1.0


def test_a_failure_restarts_the_sojourn_of_the_detection_where_the_plant_says_so() -> None:
    fault = np.array([1] * 10 + [2] * 10)
    record = ModeRecord(fault, np.ones(20, dtype=np.int64) + (np.arange(20) > 18), 0.1)

    def long(restarts: bool) -> float:
        return sum(each.exposure_s for each in jump_rates([record], (1.05,), restarts=restarts) if each.fault and each.after_s)

    assert long(False) == pytest.approx(0.9) and long(True) == 0.0


def test_what_is_no_record_is_refused() -> None:
    with pytest.raises(FieldError, match="edges"):
        jump_rates([recorded(PLANT, 0, 100)], (0.3, 0.2))
    with pytest.raises(FieldError, match="fewer than two samples"):
        jump_rates([recorded(PLANT, 0, 1)])
    with pytest.raises(DesignError, match="jumps are missed"):
        jump_rates([recorded(PLANT, 0, 200, 0.5)])


def test_a_jump_is_counted_in_the_mode_that_it_leaves() -> None:
    record = ModeRecord(np.array([1, 1, 2, 2, 2]), np.array([1, 1, 1, 2, 2]), 0.01)
    found = {each[:3]: each for each in jump_rates([record])}
    assert found[None, 1, 2].jumps == 1 and found[None, 1, 2].exposure_s == pytest.approx(0.02)
    assert found[2, 1, 2].jumps == 1 and found[2, 1, 2].exposure_s == pytest.approx(0.01)
    assert found[1, 1, 2].jumps == 0 and (2, 2, 1) in found and (1, 2, 1) not in found
    never = found[None, 2, 1]
    assert (never.jumps, never.rate, never.low) == (0, 0.0, 0.0) and never.high == pytest.approx(-np.log(0.025) / 0.02 / 0.75)
