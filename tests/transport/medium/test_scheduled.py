"""Media on which nodes wait: turns in a cycle or a chain, and a bus on which the lowest identifier wins; clocks of samples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pytest

from transport.draws import DELIVERED, LOST, REPLACED
from transport.laws.age import ConstantAge
from transport.medium import IndependentChannels, Medium, SampleClock, SplitMedium
from transport.medium.independent import Impairment, impair
from transport.medium.scheduled import ArbitratedBus, RandomTurns, RoundRobin, ScheduledMedium


def lost_and_came(shared: Medium, slots: int) -> tuple[int, int]:
    """Offer a packet of the only node in every slot; count those booked as lost and those that arrive: always one of both."""
    lost = came = 0
    for k in range(slots):
        shared.offer(0, k, k)
        ((draws, arrivals),) = shared.collect(k)
        gone = [d for d in draws if d.reason == LOST]
        assert bool(gone) != any(g == k for g, _ in arrivals)
        lost, came = lost + len(gone), came + any(g == k for g, _ in arrivals)
    return lost, came


def channels(count: int, age: int = 0) -> list[Impairment]:
    return [impair(ConstantAge(age=age), np.random.default_rng(n), 0.05, 0.03) for n in range(count)]


def test_the_cycle_begins_at_its_phase_and_a_node_on_no_medium_sends_in_every_slot() -> None:
    *turning, free = channels(4, age=1)
    scheduled = ScheduledMedium(turning, RoundRobin((2, 0, 1), 1, 0.0, np.random.default_rng(0)))
    shared = SplitMedium([((0, 1, 2), scheduled), ((3,), IndependentChannels([free]))])
    senders = []
    for k in range(7):
        senders.append([n for n in range(4) if shared.may_send(n, k)])
        for n in senders[-1]:
            shared.offer(n, k, (n, k))
        arrived = [packet for _, arrivals in shared.collect(k) for g, packet in arrivals if g == k - 1]
        assert arrived == ([(n, k - 1) for n in senders[-2]] if k else [])
    assert senders == [[0, 3], [1, 3], [2, 3], [0, 3], [1, 3], [2, 3], [0, 3]]


def test_sending_out_of_turn_is_a_fault_of_the_caller() -> None:
    shared = ScheduledMedium(channels(2), RoundRobin((0, 1), 0, 0.0, np.random.default_rng(0)))
    with pytest.raises(ValueError, match="node: 1 sends in slot 0"):
        shared.offer(1, 0, "x")


def test_turns_follow_their_chain_and_losses_their_probability() -> None:
    """4.9 standard errors each: one right generator in 10^6 is refused for each of 6 counts; a share 1 % off would be seen."""
    matrix, slots = [[0.1, 0.6, 0.3], [0.5, 0.25, 0.25], [1.0, 0.0, 0.0]], 60_000
    turns = RandomTurns((0, 1, 2), matrix, (0.0, 1.0, 0.0), 0.2, np.random.default_rng(4))
    seen = [turns.turn() for _ in range(slots)]
    nodes = np.array([node for node, _ in seen])
    assert nodes[0] == 1
    for i, row in enumerate(matrix):
        after = nodes[1:][nodes[:-1] == i]
        for j, p in enumerate(row):
            assert abs((after == j).mean() - p) <= 4.9 * np.sqrt(p * (1 - p) / len(after))
    assert abs(np.mean([lost for _, lost in seen]) - 0.2) < 4.9 * np.sqrt(0.16 / slots)


def test_what_is_lost_on_the_medium_never_comes_and_is_booked() -> None:
    lost, came = lost_and_came(ScheduledMedium(channels(1), RoundRobin((0,), 0, 0.5, np.random.default_rng(1))), 200)
    assert lost + came == 200 and 60 < lost < 140


def bus(count: int, *, frames: int = 1, loss: float = 0.0, age: int = 0) -> ArbitratedBus:
    channels = [impair(ConstantAge(age=age), np.random.default_rng(n), 0.05, 0.03) for n in range(count)]
    return ArbitratedBus(channels, frames, loss, np.random.default_rng(9))


def received(medium: ArbitratedBus, offers: Mapping[int, Sequence[int]], slots: int) -> list[list[tuple[int, int]]]:
    """(node, slot of its sample) of what arrives for the first time, slot by slot."""
    found = []
    for k in range(slots):
        for node in offers.get(k, ()):
            assert medium.may_send(node, k)
            medium.offer(node, k, (node, k))
        arrived = []
        for node, (draws, arrivals) in enumerate(medium.collect(k)):
            new = {d.packet_slot for d in draws if d.reason == DELIVERED}
            for g, packet in arrivals:
                assert packet == (node, g)
                arrived += [(node, g)] if g in new else []
        found.append(arrived)
    return found


def test_the_lowest_identifier_wins_and_the_others_wait() -> None:
    offers = {0: [2, 0, 1], 1: [], 2: [0], 3: [1]}
    assert received(bus(3), offers, 6) == [[(0, 0)], [(1, 0)], [(0, 2)], [(1, 3)], [(2, 0)], []]
    assert received(bus(3, frames=2), offers, 4) == [[(0, 0), (1, 0)], [(2, 0)], [(0, 2)], [(1, 3)]]


def test_a_newer_sample_takes_the_place_of_the_waiting_one_and_is_booked() -> None:
    shared = bus(2)
    booked = []
    for k in range(4):
        shared.offer(0, k, "a")
        if k != 3:
            shared.offer(1, k, "b")
        booked += [(k, node, d.packet_slot, d.age) for node, (draws, _) in enumerate(shared.collect(k)) for d in draws
                   if d.reason == REPLACED]  # fmt: skip
    assert booked == [(1, 1, 0, 1), (2, 1, 1, 1)]
    ((_, _), (draws, arrivals)) = shared.collect(4)
    assert arrivals == [(2, "b")] and [(d.packet_slot, d.age) for d in draws if d.reason == DELIVERED] == [(2, 0)]


def test_what_wins_travels_on_through_the_channel_of_its_node() -> None:
    assert received(bus(2, age=2), {0: [0, 1]}, 5) == [[], [], [(0, 0)], [(1, 0)], []]


def test_what_the_bus_loses_never_comes() -> None:
    """200 frames, each lost with probability 1/2: 60 to 140 of them, one right bus in 10^8 is refused."""
    lost, came = lost_and_came(bus(1, loss=0.5), 200)
    assert lost + came == 200 and 60 < lost < 140


def test_a_packet_for_a_past_slot_or_a_second_one_is_a_fault_of_the_caller() -> None:
    shared = bus(2)
    shared.offer(1, 0, "x")
    with pytest.raises(ValueError, match="k: node 1 offers a packet in slot 0 after one in slot 0"):
        shared.offer(1, 0, "y")
    shared.collect(3)
    with pytest.raises(ValueError, match="k: slot 3 is offered a packet after it was collected"):
        shared.offer(0, 3, "x")


def test_media_side_by_side_keep_their_nodes() -> None:
    """Nodes 0 and 2 take turns, nodes 1 and 3 share a bus."""
    turning = ScheduledMedium(channels(2), RoundRobin((1, 0), 0, 0.0, np.random.default_rng(5)))
    medium = SplitMedium([((1, 3), bus(2)), ((0, 2), turning)])
    seen = []
    for k in range(3):
        offering = [node for node in range(4) if medium.may_send(node, k)]
        for node in offering:
            medium.offer(node, k, node)
        found = medium.collect(k)
        fresh = [{d.packet_slot for d in draws if d.reason == DELIVERED} for draws, _ in found]
        seen.append([(node, g) for node, (_, arrivals) in enumerate(found) for g, _ in arrivals if g in fresh[node]])
    assert seen == [[(1, 0), (2, 0)], [(0, 1), (1, 1)], [(1, 2), (2, 2)]]


def test_a_clock_with_jitter_is_late_by_every_amount_alike() -> None:
    """Slots of 20,000 samples; 4.9 standard errors for each of 3 shares: one right clock in 3 * 10^5 is refused."""
    clock, count = SampleClock(every=5, phase=1, jitter=2, rng=np.random.default_rng(0)), 20_000
    due = np.array([k for k in range(5 * count) if clock.due(k)])
    late = due - 1 - 5 * np.arange(len(due))
    assert len(due) == count and set(late) == {0, 1, 2}
    for each in range(3):
        assert abs((late == each).mean() - 1 / 3) < 4.9 * np.sqrt(2 / 9 / count)


def test_a_drawn_phase_is_constant_in_a_run_and_differs_between_runs() -> None:
    firsts = set()
    for seed in range(60):
        clock = SampleClock(every=3, phase=None, rng=np.random.default_rng(seed))
        due = [k for k in range(12) if clock.due(k)]
        assert np.diff(due).tolist() == [3, 3, 3]
        firsts.add(due[0])
    assert firsts == {0, 1, 2}


@pytest.mark.parametrize(
    ("given", "field"), [({"every": 0}, "every"), ({"jitter": 1}, "jitter"), ({"every": 2, "phase": 2}, "phase"),
                         ({"every": 2, "phase": None}, "rng")],
)  # fmt: skip
def test_a_clock_that_cannot_be_is_refused_by_its_field(given: dict[str, int | None], field: str) -> None:
    with pytest.raises(ValueError, match=f"^{field}: "):
        SampleClock(**given)  # type: ignore[arg-type]
