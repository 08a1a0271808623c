"""Goodness of fit: p-values are uniform under the law, tiny when the law is wrong, and zero for what cannot happen.

Fixed seeds. A uniformity test misses a right implementation with probability 1e-4 by construction; the chi-square approximation
itself is good to about one per cent at these run lengths, which the sample sizes do not resolve.
"""

from __future__ import annotations

import dataclasses
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy import stats

from hil.measure.network_paths import network_metrics
from transport.draws import DUPLICATED, LOST, SENT, Draw
from transport.law_tests import chi_square_tail, is_testable, law_p_value, transition_counts
from transport.laws.age import ConstantAge, IidAge, MarkovAge
from transport.laws.packet import GilbertElliott, PacketLaw
from transport.laws.semi_markov import SemiMarkovAge
from transport.laws.sojourn import DiscreteWeibull, Geometric, Table, Uniform
from transport.laws.trace import TraceAge
from transport.medium.independent import impair

LAMBDA = MarkovAge(matrix=((0.6, 0.4, 0.0), (0.7, 0.2, 0.1), (0.8, 0.1, 0.1)))
PI = MarkovAge(matrix=((0.5, 0.5), (0.7, 0.3)))
BURSTY = SemiMarkovAge(
    matrix=((0, 1, 0), (0.6, 0, 0.4), (0.5, 0.5, 0)),
    sojourn=(DiscreteWeibull(q=0.9, beta=0.7), Uniform(low=1, high=3), Table(probabilities=(0.2, 0.0, 0.8))),
)
CHANNEL = GilbertElliott(p_gb=0.1, p_bg=0.3, loss_good=0.05, loss_bad=0.7)
GAMMA = PacketLaw(latency={"dist": "gamma", "a": 2.0, "scale": "3 ms"}, loss=CHANNEL, duplication=0.2).prepared()


def modes(law: Any, slots: int, seed: int) -> np.ndarray:
    draw = law.start(np.random.default_rng(seed)).draw
    return np.array([draw()[0] for _ in range(slots)])


def records(law: Any, slots: int, seed: int) -> list[Draw]:
    network, draws = impair(law, np.random.default_rng(seed), 0.005, 0.003), []
    for k in range(slots):
        network.offer(k, None)
        draws += network.collect(k)[0]
    return draws


def table_of(draws: list[Draw]) -> np.ndarray:
    rows = [(draw.slot, draw.mode, draw.latency_s, draw.reason) for draw in draws]
    return np.array(rows, [("slot", "<i4"), ("mode", "i1"), ("latency_s", "<f8"), ("reason", "u1")])


def packet_p_value(law: PacketLaw, draws: list[Draw]) -> float:
    return law_p_value(law, np.array([draw.mode for draw in draws if draw.mode >= 0]), [table_of(draws)])


@pytest.mark.parametrize("law", [GAMMA, PacketLaw(latency="3 ms", loss=CHANNEL).prepared()], ids=["gamma", "constant"])
def test_packets_in_pieces_have_the_p_value_of_all_together(law: PacketLaw) -> None:
    draws = records(law, 3000, 5)
    table = table_of(draws)
    drawn = table["mode"][table["mode"] >= 0].astype(int)
    found = packet_p_value(law, draws)
    assert 0.0 < found < 1.0
    assert found == law_p_value(law, drawn, iter(np.split(table, [7, 7, 900])))
    table["latency_s"][np.flatnonzero(table["reason"] == SENT)[-1]] = -1.0
    assert law_p_value(law, drawn, iter(np.split(table, [7, 7, 900]))) == 0.0


@pytest.mark.parametrize("law", [LAMBDA, PI, BURSTY, IidAge(probabilities=(0.8, 0.2))], ids=["lambda", "pi", "bursty", "iid"])
def test_p_values_are_uniform_under_the_law(law: Any) -> None:
    p_values = [law_p_value(law, modes(law, 1000, seed)) for seed in range(200)]
    assert stats.kstest(p_values, "uniform").pvalue > 1e-4
    rejected = np.count_nonzero(np.array(p_values) < 0.05)
    assert stats.binomtest(rejected, 200, 0.05).pvalue > 1e-4, "a level of 5 % rejects 5 % of the runs"


def test_p_values_of_packet_laws_are_uniform_too() -> None:
    p_values = [packet_p_value(GAMMA, records(GAMMA, 400, seed)) for seed in range(40)]
    assert stats.kstest(p_values, "uniform").pvalue > 1e-4


RARE, SLOTS = 0.01, 500
JUMPS = MarkovAge(matrix=((1.0 - RARE, RARE), (1.0, 0.0)))
ENDS = SemiMarkovAge(matrix=((0, 1), (1, 0)), sojourn=(Table(probabilities=(RARE, 1.0 - RARE)), Table(probabilities=(1.0,))))


def test_a_right_law_hardly_ever_gets_a_tiny_p_value_where_little_is_expected() -> None:
    """Exact, by the binomial law of what is expected five times: of Pearson's statistic alone 60 times as often as it says."""
    chances = stats.binom.pmf(np.arange(SLOTS + 1), SLOTS, RARE)
    for law, record in (
        (JUMPS, lambda seen: [0, 1] * seen + [0] * (SLOTS - seen + 1)),
        (ENDS, lambda seen: [1] + [0, 1] * seen + [0, 0, 1] * (SLOTS - seen) + [0]),
    ):  # fmt: skip
        found = np.array([law_p_value(law, np.array(record(seen))) for seen in range(40)])
        for level in (1e-6, 1e-5, 1e-4, 1e-3):
            assert 0.0 < chances[:40][found < level].sum() + chances[40:].sum() <= level


WRONG: list[tuple[Any, Any]] = [
    (MarkovAge(matrix=((0.5, 0.5, 0.0), (0.7, 0.2, 0.1), (0.8, 0.1, 0.1))), LAMBDA),
    (MarkovAge(matrix=((0.9, 0.1), (0.14, 0.86))), IidAge(probabilities=(7 / 12, 5 / 12))),
    (IidAge(probabilities=(0.8, 0.2)), MarkovAge(matrix=((0.9, 0.1), (0.4, 0.6)))),
    (
        # the same means, other sojourns: only the hazard distinguishes them
        SemiMarkovAge(matrix=((0, 1), (1, 0)), sojourn=(Geometric(p=0.25), Geometric(p=0.5))),
        SemiMarkovAge(matrix=((0, 1), (1, 0)), sojourn=(Uniform(low=1, high=7), Uniform(low=1, high=3))),
    ),
]


@pytest.mark.parametrize(("law", "truth"), WRONG)
def test_a_wrong_law_gets_a_tiny_p_value(law: Any, truth: Any) -> None:
    assert law_p_value(law, modes(truth, 3000, 1)) < 1e-6
    assert law_p_value(truth, modes(law, 3000, 1)) < 1e-6


@pytest.mark.parametrize(
    "wrong",
    [
        {"loss": GilbertElliott(p_gb=0.1, p_bg=0.3, loss_good=0.05, loss_bad=0.5)},
        {"loss": GilbertElliott(p_gb=0.2, p_bg=0.3, loss_good=0.05, loss_bad=0.7)},
        {"duplication": 0.3},
        {"latency": "6 ms"},
        {"latency": {"dist": "gamma", "a": 3.0, "scale": "2 ms"}},
    ],
    ids=repr,
)
def test_a_wrong_packet_law_gets_a_tiny_p_value(wrong: dict[str, Any]) -> None:
    right = {"latency": GAMMA.latency, "loss": GAMMA.loss, "duplication": GAMMA.duplication}
    assert packet_p_value(PacketLaw(**(right | wrong)), records(GAMMA, 4000, 1)) < 1e-6


def test_what_cannot_happen_has_probability_zero() -> None:
    assert law_p_value(LAMBDA, np.array([0, 1, 2, 0, 2])) == 0.0  # 0 to 2
    assert law_p_value(PI, np.array([0, 1, 2])) == 0.0  # no such mode
    assert law_p_value(BURSTY, np.array([0, 1, 1, 1, 1, 0])) == 0.0  # a sojourn of 4, at most 3 are possible
    assert law_p_value(BURSTY, np.array([0, 1, 2, 2, 0])) == 0.0  # a sojourn of 2, only 1 and 3 are
    assert law_p_value(BURSTY, np.array([0, 0, 2])) == 0.0  # 0 to 2 in the embedded chain
    assert law_p_value(PacketLaw(latency="1 ms"), np.zeros(1, int), [table_of([Draw(0, 0, 0, -1, np.nan, LOST)])]) == 0.0


def test_a_constant_or_a_trace_agrees_or_does_not() -> None:
    assert law_p_value(ConstantAge(age=3), np.zeros(9, int)) == 1.0
    assert law_p_value(ConstantAge(age=3), np.array([0, 1])) == 0.0
    assert law_p_value(TraceAge(ages=(0, 1)), np.array([0, 1, 0])) == 1.0
    assert law_p_value(TraceAge(ages=(0, 1)), np.array([0, 1, 1])) == 0.0
    assert law_p_value(TraceAge(ages=(0, 1), past_end="refuse"), np.array([0, 1, 0])) == 0.0
    recorded = PacketLaw(latency={"trace": ["1 ms", "lost", "9 ms"]})
    assert packet_p_value(recorded, records(recorded, 100, 0)) == 1.0
    assert packet_p_value(PacketLaw(latency={"trace": ["1 ms", "2 ms", "9 ms"]}), records(recorded, 100, 0)) == 0.0


def test_a_short_or_empty_record_says_nothing() -> None:
    for law in (LAMBDA, BURSTY, GAMMA):
        assert np.isnan(law_p_value(law, np.zeros(0, int)))
    for slots in range(1, 5):
        for law in (LAMBDA, BURSTY):
            assert np.isnan(law_p_value(law, modes(law, slots, 0)))
    alternating = SemiMarkovAge(matrix=((0, 1), (1, 0)), sojourn=(Uniform(low=2, high=3), Uniform(low=2, high=3)))
    assert np.isnan(law_p_value(alternating, np.zeros(1, int)))
    assert np.isnan(packet_p_value(GAMMA, records(GAMMA, 2, 0)))
    assert law_p_value(ConstantAge(age=0), np.zeros(0, int)) == 1.0


def test_a_foreign_law_is_tested_if_it_states_its_chain() -> None:
    class Foreign:
        def transition_matrix(self) -> np.ndarray:
            return PI.transition_matrix()

    assert law_p_value(Foreign(), modes(PI, 500, 3)) == law_p_value(PI, modes(PI, 500, 3))
    assert np.isnan(law_p_value(object(), modes(PI, 500, 3)))
    assert is_testable(Foreign()) and not is_testable(object())


def test_counts_are_those_of_a_plain_loop() -> None:
    sample = modes(LAMBDA, 300, 5)
    pairs = np.zeros((3, 3), int)
    for i, j in pairwise(sample.tolist()):
        pairs[i, j] += 1
    assert (transition_counts(sample, 3) == pairs).all()
    assert not transition_counts(sample[:0], 3).any()


def test_statistics_come_from_records_or_from_a_log_alike() -> None:
    draws = records(GAMMA, 500, 2)
    kinds = [("slot", "<i8"), ("mode", "<i4"), ("latency_s", "<f8"), ("reason", "u1")]
    log = np.array([(d.slot, d.mode, d.latency_s, d.reason) for d in draws], dtype=kinds)
    found = network_metrics(log, GAMMA, "packet")
    assert found["p_value"] == packet_p_value(GAMMA, draws)
    assert found["law"] == "packet"
    assert sum(found["mode_counts"]) == 500
    assert np.sum(found["transition_counts"]) == 499
    assert found["lost"] == sum(d.reason == LOST for d in draws) == found["fates"]["lost"]
    assert found["duplicated"] == sum(d.reason == DUPLICATED for d in draws) > 0
    assert network_metrics(log[:1], LAMBDA, "markov")["mode_counts"] == [1, 0, 0]


def test_a_law_that_discards_old_packets_is_accepted_and_another_is_not() -> None:
    """What the receiver discards is booked as lost: no loss of the channel. 40 right records, each rejected once in 10^6."""
    slot = 0.05, 0.03
    law = PacketLaw(latency={"dist": "gamma", "a": 2.0, "scale": "20 ms"}, loss=0.1, discard_older=1)
    for seed in range(40):
        process = law.start(np.random.default_rng([27, seed]), *slot)
        draws = [table_of([draw for k in range(3000) for draw in process.draw(k)])]
        channel = np.zeros(3000, dtype=np.int64)
        assert law_p_value(law, channel, draws, slot) > 1e-6
        assert law_p_value(dataclasses.replace(law, discard_older=0), channel, draws, slot) < 1e-12
        assert law_p_value(dataclasses.replace(law, loss=0.2), channel, draws, slot) < 1e-12


@pytest.mark.parametrize("freedom", [1, 2, 3, 4, 17, 100, 1001, 20_000])
@pytest.mark.parametrize("share", [0.0, 0.2, 0.9, 1.0, 1.1, 2.0, 8.0])
def test_the_tail_of_chi_square_is_that_of_scipy(freedom: int, share: float) -> None:
    statistic = share * freedom
    assert chi_square_tail(statistic, freedom) == pytest.approx(stats.chi2.sf(statistic, freedom), rel=1e-9, abs=1e-300)
