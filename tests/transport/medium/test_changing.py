"""A network whose law is changed in a run: what it costs, and which packets the new law finds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from transport.draws import DELIVERED
from transport.laws.age import ConstantAge
from transport.medium import ChangingMedium, IndependentChannels, OneWay
from transport.medium.independent import AgeImpairment, impair

FAR = 1_000_000


@dataclass
class Counted:
    """An age law of two slots that counts its draws."""

    draws: int = 0

    @property
    def draw(self) -> Callable[[], tuple[int, int]]:
        def one() -> tuple[int, int]:
            self.draws += 1
            return 0, 2

        return one


def test_a_change_after_a_million_slots_draws_as_little_as_one_at_the_beginning() -> None:
    before, process = impair(ConstantAge(age=0), np.random.default_rng(0), 0.001, 0.0, FAR - 5), Counted()
    medium = ChangingMedium(IndependentChannels([before]), 1, depth=3)
    channel = OneWay(medium)
    for k in range(FAR - 5, FAR):
        channel.offer(k, k)
        channel.collect(k)
    medium.change(IndependentChannels([AgeImpairment(process, period_s=0.001, first=FAR - 3)]), FAR, FAR - 3)
    assert process.draws == 3
    channel.offer(FAR, FAR)
    draws, arrivals = channel.collect(FAR)
    assert arrivals == [(FAR - 2, FAR - 2)] and draws[-1].reason == DELIVERED, "packets of late arrive under the new law"


def test_a_medium_of_several_nodes_takes_over_the_packets_of_each() -> None:
    def of(age: int, first: int = 0) -> IndependentChannels:
        laws = (ConstantAge(age=age), ConstantAge(age=age))
        return IndependentChannels([impair(law, np.random.default_rng(0), 0.001, 0.0, first) for law in laws])

    medium = ChangingMedium(of(0), 2, depth=3)
    for k in range(10):
        for node in (0, 1):
            medium.offer(node, k, (node, k))
        medium.collect(k)
    medium.change(of(1, first=7), 10, 7)
    for node in (0, 1):
        medium.offer(node, 10, (node, 10))
    assert [arrivals for _, arrivals in medium.collect(10)] == [[(9, (0, 9))], [(9, (1, 9))]]
