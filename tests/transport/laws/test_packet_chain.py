"""The chain of ages under a packet law is that of the packets that run, entry by entry.

Every count of a transition is tested by its exact binomial law. A right chain is refused with probability `FALSE` at most in a
whole test (Bonferroni); what a wrong one meets is a test of its own.
"""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from transport.draws import LOST, SENT
from transport.errors import FieldError, NotKnown
from transport.law_tests.analysis import analyse_law
from transport.laws import AgeChain, InitialLaw, PacketAges, prepare
from transport.laws.packet import GilbertElliott, PacketLaw
from transport.laws.packet_chain import PacketChain
from transport.laws.stochastic_matrix import chain_ages, several_of_many
from transport.medium.independent import impair

T, DEADLINE = 0.010, 0.004
FALSE = 1e-6


def chain_of(law: PacketLaw, reach: int = 0) -> PacketChain:
    chain = law.age_chain(T, DEADLINE, reach)
    assert isinstance(chain, PacketChain), chain
    return chain


def random_law(seed: int) -> PacketLaw:
    """A law with latencies of up to 0 to 4 slots; none, independent or Gilbert-Elliott loss; copies; or first in, first out."""
    rng = np.random.default_rng([27, seed])
    longest = float(rng.uniform(0.0, 4.0)) * T + DEADLINE
    knots = np.sort(rng.uniform(0.0, longest, 3))
    table = [[0.0, float(knots[0])], [float(rng.uniform(0.1, 0.9)), float(knots[1])], [1.0, float(knots[2])]]
    loss = [0.0, float(rng.uniform(0.02, 0.6)), GilbertElliott(
        p_gb=float(rng.uniform(0.05, 0.4)), p_bg=float(rng.uniform(0.1, 0.6)),
        loss_good=float(rng.uniform(0.0, 0.2)), loss_bad=float(rng.uniform(0.4, 1.0)),
    )][seed % 3]  # fmt: skip
    waits = seed // 3 % 2 == 1
    copies = 0.0 if waits else float(rng.choice([0.0, 0.3]))
    discard = None if waits or rng.random() < 0.7 else int(rng.integers(0, 3))
    return PacketLaw(latency={"table": table}, loss=loss, duplication=copies, reordering=not waits, discard_older=discard)  # type: ignore[arg-type]


def counted(law: PacketLaw, chain: PacketChain, seed: int, runs: int, slots: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Transitions and first states of the packets that `newest_of_batch` delivers, which is what runs."""
    newest, reported = law.newest_of_batch([np.random.default_rng([seed, i]) for i in range(runs)], runs, slots, T, DEADLINE)
    assert reported.all()
    levels = several_of_many([np.random.default_rng([seed, i]) for i in range(runs)], runs, slots, 5)[0]
    rows = law.transition_matrix().tolist()
    channel = chain_ages(law.stationary().tolist(), rows, range(len(rows)), levels)
    ages = np.minimum(np.arange(slots)[:, None] - newest, max(chain.mode_ages))
    number = states_of(law, chain)
    visited = np.empty((slots, runs), dtype=np.int64)
    for k in range(slots):
        for run in range(runs):
            length = max(1, min(int(ages[k, run]), chain.bound))
            known = channel[max(0, k - length + 1) : k + 1, run][::-1].tolist()
            if len(known) < length:  # the packet of slot -1 stands for what has not come
                known += [-1] * (length - len(known))
            visited[k, run] = number.get((int(ages[k, run]), tuple(known)), -1)
    found = np.zeros((len(chain.matrix) + 1,) * 2, dtype=np.int64)
    np.add.at(found, (visited[:-1].ravel(), visited[1:].ravel()), 1)
    first = np.bincount(visited[0], minlength=len(chain.matrix))
    assert (visited[chain.bound :] >= 0).all(), "a state that the chain does not have"
    return found[:-1, :-1], first


def states_of(law: PacketLaw, chain: PacketChain) -> dict[tuple[int, tuple[int, ...]], int]:
    """Number of every state (age, modes of the channel): the order of the chain is that of the pairs."""
    modes = len(law.channel_losses())
    every = [
        (age, tuple(int(c) for c in known))
        for age in sorted(set(chain.mode_ages))
        for known in np.ndindex(*(modes,) * max(1, min(age, chain.bound)))
    ]
    reached = [state for state in every if state[0] in chain.mode_ages]
    assert len(reached) == len(chain.mode_ages), "this test knows laws whose channel comes to every mode"
    return {state: i for i, state in enumerate(reached)}


def smallest_p(matrix: NDArray[np.float64], found: NDArray[np.int64]) -> tuple[float, int]:
    """Smallest p-value of any entry, and how many were tested."""
    n = found.sum(axis=1, keepdims=True) * np.ones_like(found)
    low, high = stats.binom.cdf(found, n, np.minimum(matrix, 1.0)), stats.binom.sf(found - 1, n, np.minimum(matrix, 1.0))
    return float(np.minimum(1.0, 2.0 * np.minimum(low, high)).min()), found.size


def refuse(law: PacketLaw, chain: PacketChain, seed: int, runs: int, slots: int) -> bool:
    found, first = counted(law, chain, seed, runs, slots)
    p, tested = smallest_p(chain.matrix, found)
    q, begun = smallest_p(chain.first[None], first[None])
    return p < FALSE / tested / 2 or q < FALSE / begun / 2


@pytest.mark.parametrize("seed", range(12))
def test_chain_is_that_of_the_packets(seed: int) -> None:
    law = random_law(seed)
    assert not refuse(law, chain_of(law, reach=seed % 4), seed, 20, 1000)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(50))
def test_chain_is_that_of_a_million_packets(seed: int) -> None:
    law = random_law(seed)
    assert not refuse(law, chain_of(law, reach=seed % 4), seed, 50, 20_000)


@pytest.mark.parametrize("waits", [False, True])
@pytest.mark.parametrize("bursts", [False, True])
def test_a_wrong_chain_is_refused(waits: bool, bursts: bool) -> None:
    """Power: 5 % more loss, the other order, and latencies that are not conditioned on what has not come, in 20,000 packets."""
    loss = GilbertElliott(p_gb=0.1, p_bg=0.3, loss_good=0.05, loss_bad=0.8) if bursts else 0.2
    more = GilbertElliott(p_gb=0.1, p_bg=0.3, loss_good=0.10, loss_bad=0.8) if bursts else 0.25
    law = PacketLaw(latency={"table": [[0, "0 ms"], [1, "34 ms"]]}, loss=loss, reordering=not waits)
    assert not refuse(law, chain_of(law), 1, 20, 1000)
    for wrong in (dataclasses.replace(law, loss=more), dataclasses.replace(law, reordering=waits)):
        assert refuse(law, chain_of(wrong), 1, 20, 1000)


@pytest.mark.parametrize("seed", range(24))
def test_long_run_is_that_of_the_formula_of_ages(seed: int) -> None:
    """The shares of ages, which `packet_age_shares` has by products of matrices, are the chain's stationary law."""
    law = random_law(seed)
    if law.reordering:
        chain, exact = chain_of(law, reach=12), analyse_law(law, T, DEADLINE).age_shares
        weights = np.linalg.matrix_power(chain.matrix, 4096)[0]
        shares = np.bincount(chain.mode_ages, weights=weights, minlength=14)
        np.testing.assert_allclose(shares[:13][: len(exact)], exact[:13], atol=1e-10)


def test_closed_form_of_independent_latencies() -> None:
    """Issue 27: given age a, packet k - i comes with P(L = i + 1 | L > i), whatever came before."""
    law = PacketLaw(latency={"table": [[0, "4 ms"], [0.5, "4 ms"], [0.5, "14 ms"], [0.8, "14 ms"], [0.8, "24 ms"], [1, "24 ms"]]})
    chain = chain_of(law)
    assert chain.mode_ages == (0, 1, 2)
    np.testing.assert_allclose(chain.matrix, [[0.5, 0.5, 0.0], [0.5, 0.3, 0.2], [0.5, 0.3, 0.2]], atol=1e-12)
    np.testing.assert_allclose(chain.first, [0.5, 0.5, 0.0])


def test_loss_beyond_the_longest_latency_is_one_state() -> None:
    law = PacketLaw(latency="3 ms", loss=0.3)
    chain = chain_of(law)
    assert chain.mode_ages == (0, 1)
    np.testing.assert_allclose(chain.matrix, [[0.7, 0.3], [0.7, 0.3]])
    assert chain_of(law, reach=3).mode_ages == (0, 1, 2, 3, 4)


def test_states_of_a_channel_are_more_than_the_issue_counts() -> None:
    """Issue 27 says (J + 1) 2^J at most. With J = 0 the channel's mode is needed all the same, and "older" has states of its own:
    2 + (2 + ... + 2^J) + 2^J, which is 3 * 2^J for J > 0."""
    channel = GilbertElliott(p_gb=0.1, p_bg=0.3, loss_good=0.1, loss_bad=0.8)
    for longest in range(5):
        table = [[0, "0 ms"], [1, f"{4 + 10 * longest} ms"]]
        chain = chain_of(PacketLaw(latency={"table": table}, loss=channel))
        assert len(chain.mode_ages) == (3 * 2**longest if longest else 4)


def test_discarding_bounds_what_has_no_bound() -> None:
    law = PacketLaw(latency={"dist": "gamma", "a": 2.0, "scale": "3 ms"}, loss=0.1)
    open_ended, bounded = chain_of(law), chain_of(dataclasses.replace(law, discard_older=2))
    assert open_ended.neglected == 2.0**-33
    assert bounded.neglected == 0.0
    assert bounded.bound == 2
    assert not refuse(dataclasses.replace(law, discard_older=2), bounded, 3, 20, 1000)
    assert isinstance(law, PacketAges)
    assert isinstance(bounded, AgeChain)
    assert isinstance(bounded, InitialLaw)


def test_discarding_changes_no_draw() -> None:
    """With the option the packets that stay are those that came before, bit for bit; one that is older is lost."""
    law = prepare(PacketLaw(latency={"dist": "gamma", "a": 2.0, "scale": "6 ms"}, loss=0.1, duplication=0.2))
    option = dataclasses.replace(law, discard_older=1)
    free, kept = (x.start(np.random.default_rng(5), T, DEADLINE) for x in (law, option))
    late = 0
    for k in range(2000):
        for_all, for_some = free.draw(k), kept.draw(k)
        first = for_all[0]
        if first.reason == SENT and first.age > 1:
            late += 1
            assert for_some[0].reason == LOST
        else:
            assert str(for_some[0]) == str(first)
        assert [d for d in for_all[1:] if d.age <= 1] == for_some[1:]
    assert late > 100
    network, newest, ages = impair(option, np.random.default_rng(5), T, DEADLINE), -1, []
    for k in range(2000):
        network.offer(k, k)
        newest = max([newest, *(g for g, _ in network.collect(k)[1])])
        ages.append(newest)
    many, reported = option.newest_of_batch([np.random.default_rng(5)], 1, 2000, T, DEADLINE)
    assert reported.all()
    assert many[:, 0].tolist() == ages


@pytest.mark.parametrize(("law", "reason"), [
    (PacketLaw(latency={"trace": [0.001, 0.002]}), "recorded trace"),
    (PacketLaw(latency="1 ms", duplication=0.1, reordering=False), "wait for the copies"),
    (PacketLaw(latency={"table": [[0, 0], [1, 1.0]]}, queue=50), "queue of 50"),
    (PacketLaw(latency={"table": [[0, 0], [1, 90.0]]}), "discard_older"),
    (PacketLaw(latency={"table": [[0, 0], [1, 0.1]]}, loss=GilbertElliott(p_gb=0.1, p_bg=0.1)), "at most 512"),
    (
        PacketLaw(latency=40 * T, loss=GilbertElliott(p_gb=0.1, p_bg=0.1)),
        f"latencies reach 40 slots, so that its chain has {3 << 20} states, at most 512; discard_older = J bounds it",
    ),
])  # fmt: skip
def test_a_law_without_a_chain_says_why(law: PacketLaw, reason: str) -> None:
    with pytest.raises(NotKnown, match=re.escape(reason)):
        law.age_chain(T, DEADLINE)
    if reason == "recorded trace":
        with pytest.raises(NotKnown, match=reason):
            law.delay_chances(T, DEADLINE)


@pytest.mark.parametrize(("fields", "field"), [
    ({"latency": "-1 ms"}, "latency"),
    ({"latency": {"table": [[0, "-3 ms"], [1, "2 ms"]]}}, "latency.table[0][1]"),
    ({"latency": "1 ms", "discard_older": -1}, "discard_older"),
    ({"latency": "1 ms", "discard_older": True}, "discard_older"),
    ({"latency": "1 ms", "discard_older": 2, "reordering": False}, "discard_older"),
])  # fmt: skip
def test_faulty_fields_are_refused(fields: dict[str, object], field: str) -> None:
    with pytest.raises(FieldError) as refused:
        PacketLaw(**fields)  # type: ignore[arg-type]
    assert refused.value.field == field


def test_nothing_ever_comes() -> None:
    chain = chain_of(PacketLaw(latency="1 ms", loss=1.0), reach=2)
    assert chain.matrix[-1, -1] == 1.0


def test_a_channel_that_is_never_bad_has_no_bad_state() -> None:
    """Its share of the bad state is 0, so no row leads there; the chain is that of the good one."""
    latency = {"table": [[0.0, 0.003], [1.0, 0.03]]}
    never = PacketLaw(latency=latency, loss=GilbertElliott(p_gb=0.0, p_bg=0.3, loss_good=0.1, loss_bad=0.8))
    chain, plain = chain_of(never), chain_of(PacketLaw(latency=latency, loss=0.1))
    assert len(chain.mode_ages) == len(set(chain.mode_ages))  # one window of the channel for every age
    shares = [np.bincount(one.mode_ages, one.first @ np.linalg.matrix_power(one.matrix, 200)) for one in (chain, plain)]
    assert shares[0] == pytest.approx(shares[1], abs=1e-12)
