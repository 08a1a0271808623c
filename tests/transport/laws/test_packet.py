"""Packet laws: latencies follow their law, and the impairment delivers, loses, copies and reorders as stated.

Statistics run with fixed seeds; a right law misses each limit with probability 1e-6 or less unless said otherwise.
"""

from __future__ import annotations

import math
import pickle
import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from tests.transport.medium.test_independent import run
from transport.draws import ABSENT, DELIVERED, DISORDERED, DUPLICATED, LOST, NO_MODE, REASONS, SENT
from transport.errors import FieldError
from transport.laws import load_files, prepare, slots_served
from transport.laws.delay_states import long_run
from transport.laws.latency import LatencySpec, described, latency, seconds
from transport.laws.packet import GilbertElliott, PacketLaw
from transport.laws.standard_quantiles import SHAPES, standard_quantiles
from transport.medium.independent import Impairment, impair

T, DEADLINE = 0.010, 0.004
GAMMA: LatencySpec = {"dist": "gamma", "a": 2.0, "scale": "3 ms"}
CHANNEL = GilbertElliott(p_gb=0.05, p_bg=0.3, loss_good=0.02, loss_bad=0.7)


def start(law: PacketLaw, seed: int = 0, period_s: float = T) -> Impairment:
    return impair(law, np.random.default_rng(seed), period_s, DEADLINE)


def slots_of(arrivals: list[list[tuple[int, object]]]) -> list[list[int]]:
    return [[g for g, _ in arrived] for arrived in arrivals]


# Latencies


@pytest.mark.parametrize(
    ("spec", "law"),
    [
        (GAMMA, stats.gamma(2.0, scale=0.003)),
        ({"dist": "expon", "loc": "1 ms", "scale": "2 ms"}, stats.expon(0.001, 0.002)),
        ({"dist": "lognorm", "s": 1.2, "scale": 0.002}, stats.lognorm(1.2, scale=0.002)),
        ({"dist": "norm", "loc": "20 ms", "scale": "2 ms"}, stats.norm(0.02, 0.002)),
        ({"dist": "pareto", "b": 1.5, "scale": "1 ms"}, stats.pareto(1.5, scale=0.001)),
        ({"dist": "beta", "a": 0.5, "b": 0.5, "scale": "1 s"}, stats.beta(0.5, 0.5)),
    ],
    ids=lambda value: value["dist"] if isinstance(value, dict) else "",
)
def test_tabulated_latencies_are_those_of_scipy(spec: LatencySpec, law: Any) -> None:
    table = latency(spec)
    u = np.random.default_rng(3).random(20_000)
    quantile = table.sampler()
    sample = np.array([quantile(x) for x in u.tolist()])
    assert sample == pytest.approx(law.ppf(u), rel=2e-3, abs=1e-7), "linear between knots"
    assert stats.kstest(sample, law.cdf).pvalue > 1e-6
    assert np.abs(table.cdf(sample) - law.cdf(sample)).max() < 1e-4
    assert table.cdf(sample) == pytest.approx(u, abs=1e-4), "values are rounded to 2^-24 of the middle one"


@pytest.mark.parametrize("rows", [((0.0, 0.1), (0.5, 0.05), (1.0, 0.2)), ((0.0, 0.1), (0.6, 0.2), (0.5, 0.3), (1.0, 0.4))])
@pytest.mark.parametrize("form", [tuple, list])
def test_rows_that_fall_are_refused_as_a_file_or_a_prepared_law_gives_them(rows: Any, form: Callable[[Any], Any]) -> None:
    with pytest.raises(FieldError, match="falls below the row before"):
        PacketLaw(latency={"table": form(form(row) for row in rows)})
    for last in ((1.0, math.inf), (0.9, 0.5)):
        with pytest.raises(FieldError, match=r"expected (a finite duration|levels from 0 to 1)"):
            PacketLaw(latency={"table": form(form(row) for row in ((0.0, 0.1), last))})


@pytest.mark.parametrize("name", SHAPES)
def test_quantiles_of_common_laws_are_those_of_scipy_stats(name: str) -> None:
    for shape in (0.3, 1.0, 4.0)[: 1 + 2 * len(SHAPES[name])]:
        known, given = getattr(stats, name)(*[shape] * len(SHAPES[name])), dict.fromkeys(SHAPES[name], shape)
        levels, values, end = standard_quantiles(name, given, "latency")
        assert end == known.support()[1] and len(levels) > 1000
        inner = slice(1, len(levels) // 2)  # the upper tail is asked for by its own probability
        np.testing.assert_allclose(values[inner], known.ppf(levels[inner]), rtol=1e-14)
        tail = np.ldexp(1.0 + np.arange(16) / 16.0, -30)[::-1]
        np.testing.assert_allclose(values[-65:-49], known.isf(tail), rtol=1e-14)


def test_a_discrete_law_has_atoms_in_units_of_its_scale() -> None:
    table = latency({"dist": "poisson", "mu": 3.0, "loc": "1 ms", "scale": "2 ms"})
    quantile = table.sampler()
    sample = np.array([quantile(x) for x in np.random.default_rng(4).random(20_000).tolist()])
    counts = np.rint((sample - 0.001) / 0.002).astype(int)
    assert sample == pytest.approx(0.001 + 0.002 * counts)
    expected = 20_000 * stats.poisson(3).pmf(np.arange(8))
    assert (np.abs(np.bincount(counts)[:8] - expected) < 4.9 * np.sqrt(expected)).all()
    assert table.cdf(np.array([0.0009, 0.0011, 0.0031])) == pytest.approx([0, *stats.poisson(3).cdf([0, 1])])
    assert table.mean_s == pytest.approx(0.007, rel=1e-6)


def test_a_discrete_law_far_from_zero_has_its_atoms_there() -> None:
    assert latency({"dist": "poisson", "mu": 1e6, "scale": "1 ns"}).mean_s == pytest.approx(1e-3, rel=1e-6)


def test_mean_latency_is_that_of_the_law() -> None:
    assert latency(GAMMA).mean_s == pytest.approx(0.006, rel=1e-4)
    assert latency("5 ms").mean_s == pytest.approx(0.005)
    assert latency({"trace": [0.1, "lost", "300 ms"]}).mean_s == pytest.approx(0.2)


def test_a_latency_law_can_be_described_again() -> None:
    for spec in (GAMMA, 0.01, {"trace": [0.1, "lost"], "past_end": "refuse"}):
        assert latency(described(latency(spec))) == latency(spec)


def test_durations_have_units() -> None:
    assert [seconds("x", v) for v in ("1.5 us", "2 min", "7", 3)] == [1.5e-6, 120.0, 7.0, 3.0]


Case = tuple[Callable[[], object], str]
REFUSED: list[Case] = [
    (lambda: PacketLaw(latency="3 parsecs"), "latency: got '3 parsecs', expected a duration"),
    (lambda: PacketLaw(latency=-1.0), "latency: got -1 s"),
    (lambda: PacketLaw(latency=math.nan), "latency: got nan s"),
    (lambda: PacketLaw(latency={}), "latency: got the keys []"),
    (lambda: PacketLaw(latency={"dist": "gama", "a": 1}), "latency.dist: scipy.stats has no law 'gama'; did you mean 'gamma'?"),
    (lambda: PacketLaw(latency={"dist": "norm_gen"}), "latency.dist: scipy.stats has no law 'norm_gen'"),
    (lambda: PacketLaw(latency={"dist": "gamma"}), "latency.a: missing"),
    (lambda: PacketLaw(latency={"dist": "gamma", "a": 1, "scal": 1}), "latency.scal: unknown"),
    (lambda: PacketLaw(latency={"dist": "gamma", "a": -1}), "latency: gamma(a=-1) is no law"),
    (lambda: PacketLaw(latency={"dist": "gamma", "a": "2 ms"}), "latency.a: got '2 ms', expected a number"),
    (lambda: PacketLaw(latency={"dist": "expon", "scale": "0 ms"}), "latency.scale: got 0 s"),
    (
        lambda: PacketLaw(latency={"dist": "norm", "loc": "1 ms", "scale": "1 ms"}),
        "latency: by norm() a share of 0.16 arrives before",
    ),
    (lambda: PacketLaw(latency={"table": [[0, 1]]}), "latency.table: got [[0, 1]]"),
    (lambda: PacketLaw(latency={"table": [[0, 1], [0.9, 2]]}), "latency.table[1][0]: got 0.9, expected levels from 0 to 1"),
    (lambda: PacketLaw(latency={"table": [[0, 2], [1, 1]]}), "latency.table[1]: [1, 1 s] falls below"),
    (lambda: PacketLaw(latency={"trace": []}), "latency.trace: got []"),
    (lambda: PacketLaw(latency={"trace": [0.1, "soon"]}), "latency.trace[1]: got 'soon'"),
    (lambda: PacketLaw(latency={"trace": [0.1], "past_end": "x"}), "latency.past_end: got 'x'"),
    (lambda: PacketLaw(latency=0.0, loss=1.1), "loss: got 1.1"),
    (lambda: PacketLaw(latency=0.0, duplication=math.nan), "duplication: got nan"),
    (lambda: PacketLaw(latency=0.0, queue=0), "queue: got 0"),
    (lambda: GilbertElliott(p_gb=0.1, p_bg=-0.1), "p_bg: got -0.1"),
    (lambda: GilbertElliott(p_gb=0, p_bg=0), "p_gb: 0, and p_bg is 0 too"),
    (lambda: GilbertElliott(p_gb=0.1, p_bg=0), "p_bg: 0, so that the channel once bad stays so for ever"),
    (lambda: PacketLaw(latency={"dist": "zipf", "a": 1.2, "scale": "1 ms"}), "latency: has more than 100000 possible values"),
    (lambda: PacketLaw(latency=0.0).start(np.random.default_rng(0), 0.0, 0.0), "period_s: got 0"),
    (lambda: PacketLaw(latency=0.0).start(np.random.default_rng(0), 1.0, -1.0), "deadline_s: got -1"),
]


@pytest.mark.parametrize(("make", "message"), REFUSED, ids=[message for _, message in REFUSED])
def test_a_faulty_law_is_refused_with_the_field_named(make: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError) as fault:
        make()
    assert str(fault.value).startswith(message)


def test_laws_come_from_experiment_tables() -> None:
    table = {"latency": dict(GAMMA), "loss": {"p_gb": 0.1, "p_bg": 0.5}, "reordering": False}  # type: ignore[arg-type]
    law = msgspec.convert(table, PacketLaw)
    assert law.loss == GilbertElliott(p_gb=0.1, p_bg=0.5, loss_good=0.0, loss_bad=1.0)
    assert msgspec.convert({"latency": "5 ms", "loss": 0.1}, PacketLaw).loss_probability == 0.1


def test_a_trace_of_latencies_comes_from_a_file(tmp_path: Path) -> None:
    (tmp_path / "delays.csv").write_text("slot,latency_s\n0,2 ms\n1,lost\n2,0.015\n")
    law = load_files(PacketLaw(latency={"file": "delays.csv", "past_end": "refuse"}), tmp_path)
    assert law.latency == {"trace": (0.002, "lost", 0.015), "past_end": "refuse"}
    assert slots_served(law) == 3
    with pytest.raises(ValueError, match=r"^latency.file: .*x.csv: No such file"):
        load_files(PacketLaw(latency={"file": "x.csv"}), tmp_path)


def test_a_prepared_law_draws_the_same_and_needs_no_scipy_stats() -> None:
    law = PacketLaw(latency=GAMMA, loss=CHANNEL, duplication=0.1)
    prepared = prepare(law)
    assert repr(run(start(prepared), [True] * 300)) == repr(run(start(law), [True] * 300)), "by repr, since NaN is not NaN"
    program = (
        "import sys, pickle, numpy\nfrom transport.medium.independent import impair\n"
        "law = pickle.load(sys.stdin.buffer)\nnetwork = impair(law, numpy.random.default_rng(0), 0.01, 0.004)\n"
        "for k in range(50):\n    network.offer(k, k)\n    network.collect(k)\n"
        "sys.exit('scipy.stats' in sys.modules or 'scipy' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", program], input=pickle.dumps(prepared), check=False).returncode == 0


# What the impairment does with them


@pytest.mark.parametrize(
    ("latency_s", "slots"),
    [(0.0, 0), (DEADLINE, 0), (DEADLINE + 1e-6, 1), (DEADLINE + T, 1), (DEADLINE + T + 1e-6, 2), (DEADLINE + 7 * T, 7)],
)
def test_a_latency_leads_to_the_slot_whose_deadline_it_meets(latency_s: float, slots: int) -> None:
    draws, arrivals = run(start(PacketLaw(latency=latency_s)), [True] * (slots + 2))
    assert slots_of(arrivals) == [[]] * slots + [[0], [1]]
    assert run(start(PacketLaw(latency=latency_s, reordering=False)), [True] * (slots + 2)) == (draws, arrivals)


def test_packets_that_overtake_are_disordered_and_come_in_order_of_time() -> None:
    law = PacketLaw(latency={"trace": ["25 ms", "1 ms", "12 ms", "1 ms"]})
    draws, arrivals = run(start(law), [True] * 4)
    # packet 0 arrives at 25 ms, 2 at 32 ms, both after slot 2 closed at 24 ms; 3 at 31 ms
    assert slots_of(arrivals) == [[], [1], [], [0, 3, 2]]
    fates = {d.packet_slot: REASONS[d.reason] for d in draws if d.mode == NO_MODE}
    assert fates == {0: "disordered", 1: "delivered", 2: "disordered", 3: "delivered"}


def test_without_reordering_a_packet_waits_for_the_earlier_ones() -> None:
    law = PacketLaw(latency={"trace": ["25 ms", "1 ms", "12 ms", "1 ms"]}, reordering=False)
    draws, arrivals = run(start(law), [True] * 4)
    assert slots_of(arrivals) == [[], [], [], [0, 1, 2, 3]]
    waited = {d.packet_slot: d.latency_s for d in draws if d.reason == DELIVERED}
    assert waited == pytest.approx({0: 0.025, 1: 0.015, 2: 0.012, 3: 0.002})
    assert [d.latency_s for d in draws if d.reason == SENT] == pytest.approx([0.025, 0.001, 0.012, 0.001])


def test_a_copy_that_arrives_second_is_the_duplicate() -> None:
    draws, arrivals = run(start(PacketLaw(latency=GAMMA, duplication=1.0)), [True] * 500)
    assert all(count <= 2 for count in Counter(g for arrived in slots_of(arrivals) for g in arrived).values())
    seen: set[int] = set()
    for draw in draws:
        if draw.mode == NO_MODE and draw.reason in (DELIVERED, DISORDERED, DUPLICATED):
            assert (draw.reason == DUPLICATED) == (draw.packet_slot in seen)
            seen.add(draw.packet_slot)


def test_a_full_queue_drops_and_counts() -> None:
    network = start(PacketLaw(latency=1.0, queue=3))
    draws, _ = run(network, [True] * 10)
    assert [REASONS[d.reason] for d in draws] == ["sent"] * 3 + ["overflow"] * 7


def test_a_slot_without_a_packet_is_drawn_and_absent() -> None:
    whole, _ = run(start(PacketLaw(latency=0.0, loss=CHANNEL)), [True] * 200)
    network = start(PacketLaw(latency=0.0, loss=CHANNEL))
    draws = []
    for k in range(200):
        if k % 3:
            network.offer(k, k)
        draws += network.collect(k)[0]
    assert [d.mode for d in draws if d.mode >= 0] == [d.mode for d in whole if d.mode >= 0]
    assert {d.slot for d in draws if d.reason == ABSENT} == set(range(0, 200, 3))


def test_a_change_of_loss_leaves_the_latencies_as_they_were() -> None:
    def latencies(law: PacketLaw) -> dict[int, float]:
        return {d.slot: d.latency_s for d in run(start(law), [True] * 500)[0] if d.reason == SENT}

    few, all_of_them = latencies(PacketLaw(latency=GAMMA, loss=0.3)), latencies(PacketLaw(latency=GAMMA))
    assert 250 < len(few) < 450
    assert few.items() <= all_of_them.items()


def test_heavy_tails_stay_within_the_log_s_ages() -> None:
    draws, _ = run(start(PacketLaw(latency={"dist": "pareto", "b": 0.05, "scale": "1 s"}, queue=100_000)), [True] * 2000)
    assert max(d.age for d in draws) <= 2**31 - 1


def test_the_gilbert_elliott_channel_loses_in_bursts() -> None:
    draws, _ = run(start(PacketLaw(latency=0.0, loss=CHANNEL)), [True] * 60_000)
    fate = [d for d in draws if d.mode >= 0]
    modes, lost = np.array([d.mode for d in fate]), np.array([d.reason == LOST for d in fate])
    for mode, loss in ((0, 0.02), (1, 0.7)):
        n = (modes == mode).sum()
        assert abs(lost[modes == mode].sum() - n * loss) < 4.9 * math.sqrt(n * loss * (1 - loss))
    law = PacketLaw(latency=0.0, loss=CHANNEL)
    assert law.stationary() == pytest.approx([6 / 7, 1 / 7])
    assert law.loss_probability == pytest.approx(0.02 * 6 / 7 + 0.7 / 7)
    assert long_run(law)[1] == pytest.approx([20, 1 / 0.3])


LAWS = st.builds(
    PacketLaw,
    latency=st.sampled_from([GAMMA, "0 ms", "37 ms", {"trace": ["1 ms", "lost", "40 ms"]}]).map(
        lambda spec: described(latency(spec))  # type: ignore[arg-type]
    ),
    loss=st.sampled_from([0.0, 0.3, 1.0, CHANNEL]),
    duplication=st.sampled_from([0.0, 0.4, 1.0]),
    reordering=st.booleans(),
    queue=st.sampled_from([1, 3, 1024]),
)


@settings(max_examples=60, deadline=None)
@given(law=LAWS, seed=st.integers(0, 2**32), present=st.lists(st.booleans(), max_size=80))
def test_every_packet_is_accounted_for_and_none_comes_from_the_future(law: PacketLaw, seed: int, present: list[bool]) -> None:
    network, draws = start(law, seed), []
    newest = -1
    for k, sent in enumerate(present):
        if sent:
            network.offer(k, f"packet {k}")
        decided, arrived = network.collect(k)
        draws += decided
        for g, packet in arrived:
            assert 0 <= g <= k
            assert present[g]
            assert packet == f"packet {g}"
            assert law.reordering or g >= newest, "first in, first out"
            newest = max(newest, g)
    assert [d.slot for d in draws if d.mode >= 0] == list(range(len(present))), "one draw of the law per slot, in order"
    draws += [d for d in network.collect(len(present) + 1000)[0] if d.mode == NO_MODE]  # what was on its way
    fate = Counter((REASONS[d.reason], d.mode >= 0) for d in draws)
    arrived_once = fate["delivered", False] + fate["disordered", False]
    dropped = fate["lost", True] + fate["overflow", True]
    assert fate["sent", True] == arrived_once
    assert sum(present) == arrived_once + dropped
    assert fate["duplicated", False] <= fate["copied", False]


def test_memory_is_bounded_by_latency_and_queue() -> None:
    network = start(PacketLaw(latency=0.5, duplication=1.0))
    for k in range(2000):
        network.offer(k, k)
        network.collect(k)
        assert len(network._flying) <= 102  # type: ignore[attr-defined]
        assert not network._offered  # type: ignore[attr-defined]


def test_a_recording_that_ends_before_the_run_is_named() -> None:
    following = latency({"trace": ["1 ms"], "past_end": "refuse"}).in_order()  # type: ignore[union-attr]
    assert following(0.5) == pytest.approx(1e-3)
    with pytest.raises(FieldError, match=r"^latency\.trace: has 1 entries, the run needs more"):
        following(0.5)


def test_losses_of_a_recording_and_of_the_channel_combine_and_do_not_add() -> None:
    """Half of the recording is lost, and half of what is left: three quarters, not all."""
    law = PacketLaw(latency={"trace": ["1 ms", "lost"]}, loss=0.5)
    assert law.loss_probability == pytest.approx(0.75)
