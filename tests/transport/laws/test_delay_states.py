"""The chain of the age that a receiver measures: against the emulated network, and the tails that are cut against the laws."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from transport.law_tests.analysis import analyse_law
from transport.laws.age import ConstantAge, IidAge, MarkovAge
from transport.laws.delay_states import delay_states, measured_ages
from transport.laws.packet import PacketLaw
from transport.laws.semi_markov import SemiMarkovAge, augmented_chain, hazard_bounds
from transport.laws.sojourn import DiscreteWeibull, Geometric, Table, Uniform, hazards
from transport.laws.trace import TraceAge
from transport.medium.independent import impair

GAPS = [
    IidAge(probabilities=(0.5, 0.3, 0.2), allow_gaps=True),
    IidAge(probabilities=(0.6, 0.0, 0.0, 0.4), allow_gaps=True),
    MarkovAge(matrix=((0.6, 0.1, 0.3), (0.5, 0.3, 0.2), (0.1, 0.2, 0.7)), ages=(0, 1, 3), allow_gaps=True),
    SemiMarkovAge(
        matrix=((0.0, 0.5, 0.5), (0.6, 0.0, 0.4), (1.0, 0.0, 0.0)), ages=(0, 2, 4), allow_gaps=True,
        sojourn=(Uniform(low=1, high=3), Geometric(p=0.4), Table(probabilities=(0.3, 0.3, 0.4))),
    ),
]  # fmt: skip


def received(law, slots, seed):
    """Age of the newest packet in every slot of an emulated network, from slot 20 on."""
    network = impair(law, np.random.default_rng(seed), 0.01, 0.006)
    newest, ages = -1, []
    for k in range(slots):
        network.offer(k, k)
        newest = max([newest, *(g for g, _ in network.collect(k)[1])])
        ages.append(k - newest)
    return np.array(ages[20:])


@pytest.mark.parametrize("law", GAPS, ids=["iid", "iid far", "markov", "semi-markov"])
def test_the_chain_is_that_of_the_emulated_network(law):
    # pairs of successive ages 40 slots apart, nearly independent: 1500 of them against the chain's joint law, level 1e-4.
    # Power: over the drawn law of the first case a pair (0, 2) has probability 0.1, and 1500 slots hold none.
    states = delay_states(law)
    pi = np.linalg.lstsq(
        np.vstack([states.matrix.T - np.eye(len(states.ages)), np.ones(len(states.ages))]),
        np.append(np.zeros(len(states.ages)), 1.0), rcond=None,
    )[0]  # fmt: skip
    size = int(states.ages.max()) + 1
    joint = np.zeros((size, size))
    np.add.at(joint, (states.ages[:, None], states.ages[None, :]), pi[:, None] * states.matrix)
    ages = received(law, 60_000, 3)
    counts = np.zeros_like(joint)
    np.add.at(counts, (ages[:-1:40], ages[1::40]), 1)
    assert not counts[joint < 1e-12].any()
    cells = joint > 1e-12
    assert stats.chisquare(counts[cells], counts.sum() * joint[cells] / joint[cells].sum()).pvalue > 1e-4
    assert analyse_law(law, 0.01, 0.006).age_shares == pytest.approx(joint.sum(axis=1), abs=1e-9)
    unused = analyse_law(law, 0.01, 0.006).unused
    assert unused == pytest.approx((np.diff(ages) == 1).mean(), abs=0.02)
    assert states.has_gaps


def test_the_issue_of_the_thesis_network_with_gaps():
    states = delay_states(GAPS[0])
    assert states.matrix.tolist() == [[0.5, 0.5, 0.0], [0.5, 0.3, 0.2], [0.5, 0.3, 0.2]]
    assert analyse_law(GAPS[0], 0.05, 0.03).age_shares == pytest.approx((0.5, 0.4, 0.1))


@pytest.mark.parametrize("past_end", ["repeat", "refuse"])
def test_a_recorded_law_with_gaps_is_analysed_as_it_is_received(past_end):
    law = TraceAge(ages=(2, 0, 0, 2, 3, 0), allow_gaps=True, past_end=past_end)
    found = analyse_law(law, 0.01, 0.006)
    measured = [1, 0, 0, 1, 2, 0] if past_end == "repeat" else [2, 0, 0, 1, 2, 0]
    assert found.age_shares == pytest.approx(np.bincount(measured) / 6)
    assert measured_ages(np.array([2, 0, 0, 2, 3, 0])).tolist() == [2, 0, 0, 1, 2, 0]


def test_without_gaps_the_chain_is_the_law():
    law = MarkovAge(matrix=((0.6, 0.4, 0.0), (0.7, 0.2, 0.1), (0.8, 0.1, 0.1)), initial="uniform")
    states = delay_states(law)
    assert (states.matrix == law.transition_matrix()).all()
    assert (states.low == states.matrix).all() and (states.high == states.matrix).all()
    assert states.initial == pytest.approx([1 / 3] * 3)
    assert not states.has_gaps
    assert delay_states(ConstantAge(age=1)).ages.tolist() == [1]
    assert delay_states(PacketLaw(latency="1 ms")) is None
    assert delay_states(TraceAge(ages=(0, 1))) is None


LAWS = [
    DiscreteWeibull(q=0.6, beta=0.8), DiscreteWeibull(q=0.9, beta=1.0), DiscreteWeibull(q=0.9, beta=2.5),
    Geometric(p=0.3), Uniform(low=2, high=9), Table(probabilities=(0.1, 0.0, 0.5, 0.4)),
]  # fmt: skip


@pytest.mark.parametrize("law", LAWS, ids=[type(law).__name__ + str(i) for i, law in enumerate(LAWS)])
@pytest.mark.parametrize("cut", [1, 3, 8])
def test_hazard_bounds_hold_beyond_the_cut(law, cut):
    low, high = hazard_bounds(law, cut)
    hazard = hazards(law, min(law.support, 100))[cut:]
    assert 0.0 <= low <= high <= 1.0
    assert (low - 1e-12 <= hazard).all() and (hazard <= high + 1e-12).all()


def test_a_weibull_hazard_that_falls_has_the_infimum_0():
    assert hazard_bounds(DiscreteWeibull(q=0.6, beta=0.8), 40)[0] == 0.0
    assert hazard_bounds(DiscreteWeibull(q=0.6, beta=2.0), 3)[1] == 1.0


def test_only_the_tail_that_is_cut_is_in_doubt():
    heavy = SemiMarkovAge(matrix=((0, 1), (1, 0)), sojourn=(Uniform(low=1, high=3), DiscreteWeibull(q=0.6, beta=0.8)))
    chain = augmented_chain(heavy)
    in_doubt = np.flatnonzero((chain.low != chain.high).any(axis=1))
    assert in_doubt.tolist() == [len(chain.modes) - 1]
    assert chain.high[-1, -1] == 1.0  # it may stay for ever
    light = SemiMarkovAge(matrix=((0, 1), (1, 0)), sojourn=(Geometric(p=0.3), Uniform(low=1, high=3)))
    assert (augmented_chain(light).low == augmented_chain(light).high).all()


def test_nothing_is_assumed_of_a_sojourn_law_that_does_not_bound_its_tail():
    class Stranger:
        support = 30

        def survival(self, slots):
            return 0.5 ** np.asarray(slots, dtype=float)

    class Law:
        mode_ages, matrix, sojourn = (0, 1), ((0.0, 1.0), (1.0, 0.0)), (Uniform(low=1, high=3), Stranger())

    chain = augmented_chain(Law())
    assert (chain.low[-1, 0], chain.high[-1, 0], chain.low[-1, -1], chain.high[-1, -1]) == (0.0, 1.0, 0.0, 1.0)


class Split:
    """A chain of two modes that are never left, of which nothing says where it begins."""

    mode_ages = (0, 1)

    def transition_matrix(self):
        return np.eye(2)


def test_a_chain_of_several_parts_begins_anywhere():
    assert delay_states(Split()).initial.tolist() == [0.5, 0.5]
