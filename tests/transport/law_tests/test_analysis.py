"""The long run of every law, computed: held to simulated runs and to closed forms."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from transport.draws import SUPERSEDED
from transport.law_tests import analysis
from transport.law_tests.analysis import analyse_law
from transport.laws.age import ConstantAge, IidAge, MarkovAge
from transport.laws.packet import GilbertElliott, PacketLaw
from transport.laws.semi_markov import SemiMarkovAge
from transport.laws.sojourn import Geometric, Uniform
from transport.laws.trace import TraceAge
from transport.medium.independent import impair

T, DEADLINE = 0.010, 0.004
LAMBDA = MarkovAge(matrix=((0.6, 0.4, 0.0), (0.7, 0.2, 0.1), (0.8, 0.1, 0.1)))
SEMI = SemiMarkovAge(
    matrix=((0, 1, 0), (0.6, 0, 0.4), (0.5, 0.5, 0)),
    sojourn=(Geometric(p=0.3), Uniform(low=1, high=3), Geometric(p=0.5)),
)
GAMMA = {"dist": "gamma", "a": 2.0, "scale": "6 ms"}
CHANNEL = GilbertElliott(p_gb=0.1, p_bg=0.3, loss_good=0.05, loss_bad=0.7)


def newest_ages(law: Any, slots: int, seed: int) -> Iterator[int]:
    network, newest = impair(law, np.random.default_rng(seed), T, DEADLINE), -1
    for k in range(slots):
        network.offer(k, None)
        newest = max([newest, *(g for g, _ in network.collect(k)[1])])
        if k >= 100:
            yield k - newest


@pytest.mark.parametrize(
    "law",
    [
        LAMBDA,
        SEMI,
        PacketLaw(latency=GAMMA),
        PacketLaw(latency=GAMMA, loss=0.3, duplication=0.5),
        PacketLaw(latency=GAMMA, loss=CHANNEL),
    ],
    ids=["markov", "semi-markov", "gamma", "copies", "channel"],
)
def test_age_shares_are_those_loop(law: Any) -> None:
    exact = analyse_law(law, T, DEADLINE)
    assert exact.age_method == "exact"
    assert sum(exact.age_shares) == pytest.approx(1.0, abs=1e-9)
    prepared = law.prepared() if isinstance(law, PacketLaw) else law
    means = np.array([np.mean(list(newest_ages(prepared, 1100, seed))) for seed in range(40)])
    error = means.std(ddof=1) / math.sqrt(len(means))
    assert abs(means.mean() - exact.mean_age) < 5.8 * error  # t with 39 dof, two tails of 5e-7


@pytest.mark.parametrize("law", [LAMBDA, SEMI], ids=["markov", "semi-markov"])
def test_the_unused_share_is_that_of_superseded_packets(law: Any) -> None:
    unused = []
    for seed in range(40):
        network, count = impair(law, np.random.default_rng(seed), T, DEADLINE), 0
        for k in range(1000):
            network.offer(k, None)
            count += sum(draw.reason == SUPERSEDED for draw in network.collect(k)[0])
        unused.append(count / 1000)
    error = np.std(unused, ddof=1) / math.sqrt(40)
    assert abs(np.mean(unused) - analyse_law(law, T, DEADLINE).unused) < 5.8 * error + 2e-3  # a few are undecided at the end


def test_closed_forms() -> None:
    constant = analyse_law(ConstantAge(age=3), T, DEADLINE)
    assert (constant.mean_age, constant.unused, constant.age_shares) == (3.0, 0.0, (0.0, 0.0, 0.0, 1.0))
    # immediate arrival and iid loss p: the age is geometric, Pr(age = a) = (1-p) p^a
    lossy = analyse_law(PacketLaw(latency=0.0, loss=0.25), T, DEADLINE)
    assert lossy.mean_age == pytest.approx(1 / 3)
    assert lossy.age_shares[:3] == pytest.approx([0.75, 0.1875, 0.046875])
    assert lossy.loss_probability == 0.25
    assert analyse_law(PacketLaw(latency="27 ms"), T, DEADLINE).mean_age == pytest.approx(3.0)
    iid = analyse_law(IidAge(probabilities=(0.8, 0.2)), T, DEADLINE)
    assert iid.unused == pytest.approx(0.16)
    assert iid.mean_bursts == pytest.approx((5.0, 1.25))
    assert analyse_law(TraceAge(ages=(0, 0, 1, 2)), T, DEADLINE).unused == pytest.approx(0.5)


def test_nothing_ever_arrives_when_all_is_lost() -> None:
    dead = analyse_law(PacketLaw(latency=0.0, loss=1.0), T, DEADLINE)
    assert dead.mean_age == math.inf
    assert dead.age_shares == ()


def test_what_has_no_closed_form_is_simulated_and_says_so() -> None:
    fifo = analyse_law(PacketLaw(latency=GAMMA, reordering=False), T, DEADLINE)
    free = analyse_law(PacketLaw(latency=GAMMA), T, DEADLINE)
    assert fifo.age_method == "simulated"
    assert fifo.mean_age > free.mean_age, "waiting for earlier packets makes the newest older"
    trace = analyse_law(PacketLaw(latency={"trace": ["1 ms", "lost"]}), T, DEADLINE)
    assert trace.mean_age == pytest.approx(0.5, abs=1e-3)
    assert trace.loss_probability == 0.5


def test_a_queue_that_fills_loses_and_one_that_cannot_is_exact() -> None:
    full = analyse_law(PacketLaw(latency="120 ms", queue=1), 0.05, 0.03)
    assert (full.age_method, full.loss_probability) == ("simulated", pytest.approx(2 / 3, abs=1e-3))
    assert full.overflow == full.loss_probability == pytest.approx(full.unused, abs=1e-3)
    for law in (PacketLaw(latency="120 ms", queue=3), PacketLaw(latency=GAMMA, queue=50), PacketLaw(latency=0.0, queue=1)):
        assert (analyse_law(law, 0.05, 0.03).age_method, analyse_law(law, 0.05, 0.03).overflow) == ("exact", 0.0)
    assert analyse_law(PacketLaw(latency=0.0, duplication=0.1, queue=1), T, DEADLINE).overflow == 0.0, "copies are no loss"
    rare = {"dist": "pareto", "b": 4.0, "scale": "5 ms"}  # up to 1.5 s, 7 ms in the mean: 25 in flight have a chance of 10^-18
    assert analyse_law(PacketLaw(latency=rare, queue=25), T, DEADLINE).age_method == "exact"
    heavy = PacketLaw(latency={"dist": "pareto", "b": 0.05, "scale": "1 s"})
    assert analyse_law(heavy, T, DEADLINE).overflow > 0.1
    copied = PacketLaw(latency={"dist": "expon", "scale": "100 ms"}, duplication=0.5, queue=1, discard_older=3)
    network, come = impair(copied.prepared(), np.random.default_rng(1), T, DEADLINE), set[int]()
    for k in range(20_000):
        network.offer(k, None)
        come |= {slot for slot, _ in network.collect(k)[1]}
    assert analyse_law(copied, T, DEADLINE).loss_probability == pytest.approx(1.0 - len(come) / 20_000, abs=0.015)  # 4 sd


def test_what_is_later_than_any_age_counted_makes_the_mean_a_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(analysis, "LONGEST", 1000)
    late = analyse_law(PacketLaw(latency="1 h", queue=1_000_000), T, DEADLINE)
    assert (late.older, late.mean_age) == (1.0, 1000.0)


def test_a_foreign_law_without_analysis_is_simulated() -> None:
    class Foreign:
        kind, family, max_age = "foreign", "age", 2

        def start(self, rng: np.random.Generator) -> Any:
            return LAMBDA.start(rng)

    found = analyse_law(Foreign(), T, DEADLINE)
    assert found.age_method == "simulated"
    assert found.mean_age == pytest.approx(analyse_law(LAMBDA, T, DEADLINE).mean_age, abs=0.03)
