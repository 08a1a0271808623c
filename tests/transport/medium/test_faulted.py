"""Faults on a time line: what is sent and what arrives while something is broken, and that the rest is as without them."""

from __future__ import annotations

import numpy as np

from transport.draws import CORRUPTED, CUT, OFF_BUS
from transport.laws.age import ConstantAge, MarkovAge
from transport.laws.packet import PacketLaw
from transport.medium import FaultedMedium, FaultInterval, FaultKind, FaultyPath, IndependentChannels, OneWay
from transport.medium.independent import Impairment, impair

INTERVAL = (5, 8)


def channel(age: int = 1) -> Impairment:
    return impair(ConstantAge(age=age), np.random.default_rng(0), 0.05, 0.03)


def faulted(one: Impairment, path: FaultyPath) -> Impairment:
    return OneWay(FaultedMedium(IndependentChannels([one]), [path]))


def arrivals(link: Impairment, slots: int = 12) -> dict[int, list[tuple[int, object]]]:
    found = {}
    for k in range(slots):
        link.offer(k, f"packet {k}")
        found[k] = link.collect(k)[1]
    return found


def broken(kind: FaultKind, age: int = 1) -> tuple[dict[int, list[tuple[int, object]]], FaultyPath]:
    path = FaultyPath([FaultInterval(*INTERVAL, kind)])
    return arrivals(faulted(channel(age), path)), path


def test_a_cut_loses_what_would_arrive_and_nothing_else() -> None:
    sound, (cut, _) = arrivals(channel()), broken("cut")
    assert all(not cut[k] for k in range(*INTERVAL))
    assert all(cut[k] == sound[k] for k in cut if not INTERVAL[0] <= k < INTERVAL[1])  # what was sent meanwhile comes after it


def test_a_node_off_the_bus_sends_nothing_and_a_frozen_one_repeats_its_values() -> None:
    off, _ = broken("bus-off")
    assert off[8] == [] and off[9] == [(8, "packet 8")]  # slot 8 would have had the packet of slot 7
    frozen, _ = broken("freeze")
    assert [frozen[k] for k in (5, 6, 7, 8, 9)] == [
        [(4, "packet 4")], [(5, "packet 4")], [(6, "packet 4")], [(7, "packet 4")], [(8, "packet 8")],
    ]  # fmt: skip


def test_what_was_lost_is_not_the_newest_packet_afterwards() -> None:
    """In slot 3 the law says age 1 again and again: packet 2 arrives once, in the cut, and would be repeated."""
    ages = MarkovAge(matrix=((0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)), initial=(1.0, 0.0, 0.0))
    path = FaultyPath([FaultInterval(3, 4, "cut")])
    link = faulted(impair(ages, np.random.default_rng(0), 0.05, 0.03), path)
    came = arrivals(link, 7)
    assert came[3] == came[4] == came[5] == [] and came[6] == [(6, "packet 6")]


def test_a_second_copy_of_a_lost_packet_comes() -> None:
    law = PacketLaw(latency={"dist": "uniform", "loc": 0.0, "scale": 0.2}, duplication=1.0)
    path = FaultyPath([FaultInterval(5, 6, "cut")])
    link = faulted(impair(law, np.random.default_rng(3), 0.05, 0.03), path)
    sound = arrivals(impair(law, np.random.default_rng(3), 0.05, 0.03))
    came = arrivals(link)
    gone = {g for g, _ in sound[5]}
    assert gone and came[5] == []
    assert [came[k] for k in came if k != 5] == [sound[k] for k in sound if k != 5]


def test_fates_say_which_fault_it_was_and_modes_stay_the_laws_own() -> None:
    law = MarkovAge(matrix=((0.6, 0.4), (0.7, 0.3)))
    for kind, code in (("cut", CUT), ("corrupt", CORRUPTED), ("bus-off", OFF_BUS)):
        path = FaultyPath([FaultInterval(*INTERVAL, kind)])
        links = impair(law, np.random.default_rng(1), 0.05, 0.03), faulted(
            impair(law, np.random.default_rng(1), 0.05, 0.03), path
        )
        drawn: list[list[int]] = [[], []]
        for k in range(12):
            for i, link in enumerate(links):
                link.offer(k, k)
                draws, _ = link.collect(k)
                drawn[i] += [d.mode for d in draws if d.mode >= 0]
                if i and INTERVAL[0] <= k < INTERVAL[1]:
                    assert code in {d.reason for d in draws}
                    assert bool(path.mangled) == (kind == "corrupt")
        assert drawn[0] == drawn[1] and len(drawn[0]) == 12
