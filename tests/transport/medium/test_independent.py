"""The impairment under age laws: one arrival per slot, nothing from the future, every packet accounted for."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from transport.draws import ABSENT, DELIVERED, DISORDERED, NO_MODE, NONE_YET, REASONS, REPEATED, SUPERSEDED, Draw
from transport.laws.age import ConstantAge, MarkovAge
from transport.medium.independent import Impairment, impair

LAMBDA = MarkovAge(matrix=((0.6, 0.4, 0.0), (0.7, 0.2, 0.1), (0.8, 0.1, 0.1)))
JUMPY = MarkovAge(matrix=((0.2, 0.3, 0.5), (0.4, 0.2, 0.4), (0.3, 0.3, 0.4)), allow_gaps=True)


def run(impairment: Impairment, present: Sequence[bool]) -> tuple[list[Draw], list[list[tuple[int, object]]]]:
    draws: list[Draw] = []
    arrivals = []
    for k, sent in enumerate(present):
        if sent:
            impairment.offer(k, f"packet {k}")
        decided, arrived = impairment.collect(k)
        draws += decided
        arrivals.append(arrived)
    return draws, arrivals


def start(law: MarkovAge | ConstantAge, seed: int = 0) -> Impairment:
    return impair(law, np.random.default_rng(seed), 0.05, 0.01)


def test_reason_codes_name_their_reasons() -> None:
    assert REASONS[NONE_YET] == "none-yet"
    assert REASONS[SUPERSEDED] == "superseded"
    assert len(set(REASONS)) == len(REASONS)


def test_constant_age_delivers_the_packet_of_that_age() -> None:
    draws, arrivals = run(start(ConstantAge(age=2)), [True] * 6)
    assert arrivals == [[], [], *[[(k, f"packet {k}")] for k in range(4)]]
    assert [d.reason for d in draws] == [NONE_YET, NONE_YET] + [DELIVERED] * 4
    assert draws[3].latency_s == pytest.approx(0.1)


def test_an_unchanged_newest_packet_is_repeated() -> None:
    law = MarkovAge(matrix=((0.0, 1.0), (1.0, 0.0)), initial=(1.0, 0.0))
    draws, arrivals = run(start(law), [True] * 4)
    assert [a[0][0] for a in arrivals] == [0, 0, 2, 2]
    assert [(d.slot, d.packet_slot, d.reason) for d in draws] == [
        (0, 0, DELIVERED),
        (1, 0, REPEATED),
        (2, 1, SUPERSEDED),
        (2, 2, DELIVERED),
        (3, 2, REPEATED),
    ]


def test_an_absent_packet_is_replaced_by_the_next_older_one_and_recorded() -> None:
    draws, arrivals = run(start(ConstantAge(age=1)), [True, True, False, False, True, True])
    assert [[g for g, _ in a] for a in arrivals] == [[], [0], [1], [1], [1], [4]]
    at_3 = [d for d in draws if d.slot == 3]
    assert [(d.packet_slot, d.mode, d.reason) for d in at_3] == [(2, 0, ABSENT), (1, NO_MODE, REPEATED)]


def test_absent_without_any_older_packet_delivers_nothing() -> None:
    draws, arrivals = run(start(ConstantAge(age=0)), [False, False, True])
    assert arrivals == [[], [], [(2, "packet 2")]]
    assert [d.reason for d in draws] == [ABSENT, ABSENT, DELIVERED]


def test_a_gap_law_may_come_back_to_an_older_packet() -> None:
    law = MarkovAge(matrix=((0.0, 0.0, 1.0), (0.5, 0.0, 0.5), (1.0, 0.0, 0.0)), initial=(1.0, 0.0, 0.0), allow_gaps=True)
    draws, arrivals = run(start(law), [True] * 6)
    assert [[g for g, _ in a] for a in arrivals] == [[0], [], [2], [1], [4], [3]]
    assert [d.reason for d in draws] == [DELIVERED, NONE_YET, DELIVERED, DISORDERED, DELIVERED, DISORDERED]


def test_skipped_slots_are_drawn_so_that_the_mode_sequence_stays() -> None:
    whole, _ = run(start(LAMBDA), [True] * 40)
    skipping = start(LAMBDA)
    draws: list[Draw] = []
    for k in range(40):
        skipping.offer(k, k)
        if k % 5 == 4:
            draws += skipping.collect(k)[0]
    assert [d.mode for d in draws if d.mode >= 0] == [d.mode for d in whole if d.mode >= 0]


def test_offering_out_of_order_and_collecting_twice_are_refused() -> None:
    impairment = start(LAMBDA)
    impairment.offer(0, "a")
    with pytest.raises(ValueError, match="slot 0 is offered a packet after slot 0"):
        impairment.offer(0, "b")
    impairment.collect(0)
    with pytest.raises(ValueError, match="slot 0 is collected again"):
        impairment.collect(0)
    with pytest.raises(ValueError, match="slot 0 is offered a packet after it was collected"):
        impairment.offer(0, "c")


@settings(max_examples=60, deadline=None)
@given(
    law=st.sampled_from([LAMBDA, JUMPY, ConstantAge(age=3)]),
    seed=st.integers(0, 2**32),
    present=st.lists(st.booleans()),
)
def test_every_packet_is_accounted_for_and_none_comes_from_the_future(
    law: MarkovAge | ConstantAge, seed: int, present: list[bool]
) -> None:
    impairment = start(law, seed)
    draws, arrivals = run(impairment, present)
    assert [d.slot for d in draws if d.mode >= 0] == list(range(len(present))), "one draw of the law per slot, in order"
    fate = Counter(REASONS[d.reason] for d in draws + impairment.collect(len(present) + 10)[0])
    assert sum(present) == fate["delivered"] + fate["disordered"] + fate["superseded"]
    newest = -1
    for k, arrived in enumerate(arrivals):
        assert len(arrived) <= 1
        for g, packet in arrived:
            assert 0 <= g <= k
            assert present[g]
            assert packet == f"packet {g}"
            if not law.allow_gaps:
                assert g >= newest, "a link that keeps the newest packet never goes back"
            newest = max(newest, g)


@pytest.mark.parametrize("law", [LAMBDA, JUMPY])
@pytest.mark.parametrize("present", [[True] * 3000, [True] + [False] * 3000])
def test_memory_is_bounded_by_the_largest_age(law: MarkovAge, present: list[bool]) -> None:
    impairment = start(law)
    for k, sent in enumerate(present):
        if sent:
            impairment.offer(k, k)
        impairment.collect(k)
        assert len(impairment._held) <= law.max_age + 2  # type: ignore[attr-defined]
