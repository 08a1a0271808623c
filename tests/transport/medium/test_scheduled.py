"""Turns on a shared medium: a cycle of known phase, a chain of stated probabilities, and losses of their own."""

from __future__ import annotations

import numpy as np
import pytest

from tests.transport.medium.losses import lost_and_came
from transport.laws.age import ConstantAge
from transport.medium.independent import impair
from transport.medium.scheduled import RandomTurns, RoundRobin, ScheduledMedium


def medium(turns: RoundRobin | RandomTurns, nodes: tuple[int, ...], count: int, age: int = 0) -> ScheduledMedium:
    channels = [impair(ConstantAge(age=age), np.random.default_rng(n), 0.05, 0.03) for n in range(count)]
    return ScheduledMedium(channels, [(nodes, turns)])


def test_the_cycle_begins_at_its_phase_and_a_node_on_no_medium_sends_in_every_slot() -> None:
    shared = medium(RoundRobin((2, 0, 1), 1, 0.0, np.random.default_rng(0)), (2, 0, 1), 4, age=1)
    senders = []
    for k in range(7):
        senders.append([n for n in range(4) if shared.may_send(n, k)])
        for n in senders[-1]:
            shared.offer(n, k, (n, k))
        arrived = [packet for _, arrivals in shared.collect(k) for g, packet in arrivals if g == k - 1]
        assert arrived == ([(n, k - 1) for n in senders[-2]] if k else [])
    assert senders == [[0, 3], [1, 3], [2, 3], [0, 3], [1, 3], [2, 3], [0, 3]]


def test_who_sends_out_of_turn_is_a_fault_of_the_caller() -> None:
    shared = medium(RoundRobin((0, 1), 0, 0.0, np.random.default_rng(0)), (0, 1), 2)
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
    lost, came = lost_and_came(medium(RoundRobin((0,), 0, 0.5, np.random.default_rng(1)), (0,), 1), 200)
    assert lost + came == 200 and 60 < lost < 140
