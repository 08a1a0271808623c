"""A CAN bus that takes time, slot by slot: what is complete by a deadline, what is replaced, what waits behind others."""

from __future__ import annotations

import struct

import numpy as np

from transport.can_bus_model import BitRates, CanFrame, Due, Periodic, Traffic
from transport.can_bus_model.bits import frame_length
from transport.can_bus_model.bus import CanBus, Transmission
from transport.can_bus_model.node import CanNode
from transport.draws import DELIVERED, REPLACED, SUPERSEDED
from transport.laws.age import ConstantAge
from transport.medium import OneWay
from transport.medium.independent import Impairment, impair
from transport.medium.timed_bus import BusInSlots, TimedBusWay, value_frames

T, D = 10_000_000, 4_000_000
RATES = BitRates(125_000)


def bus_of(traffic: list[Due], *, overwrite: bool = True, seen: list[Transmission] | None = None) -> BusInSlots:
    bus = CanBus(RATES, [CanNode() for _ in range(4)])
    keep = (lambda ended: None) if seen is None else seen.append
    return BusInSlots(bus, Traffic([iter(traffic)]), 2, overwrite=overwrite, period_ns=T, deadline_ns=D, seen=keep)


def channel() -> Impairment:
    return impair(ConstantAge(age=0), np.random.default_rng(0), T / 1e9, D / 1e9)


def busy(first_ns: int, until_ns: int, identifier: int = 0x10) -> list[Due]:
    """Frames that leave the bus no gap."""
    frame = CanFrame(identifier=identifier, data=bytes(8))
    length = RATES.ns(RATES.duration(frame_length(frame)))
    return [Due(at, 3, frame) for at in range(first_ns, until_ns, length)]


def to_controller(bus: BusInSlots) -> TimedBusWay:
    return TimedBusWay(bus, [channel()], [lambda packet: value_frames(0x100, packet, fd=False)])  # type: ignore[arg-type]


def test_a_packet_counts_in_its_slot_if_its_last_frame_is_complete_by_the_deadline() -> None:
    way = to_controller(bus_of([]))
    way.offer(0, 0, (1.0, 2.0, 3.0))  # two frames
    draws, arrivals = way.collect(0)[0]
    assert arrivals == [(0, (1.0, 2.0, 3.0))] and [draw.reason for draw in draws] == [DELIVERED]


def test_a_packet_that_waits_for_others_arrives_in_a_later_slot_under_the_slot_of_its_sample() -> None:
    way = to_controller(bus_of(busy(0, 15_000_000)))
    way.offer(0, 0, (1.0,))
    assert way.collect(0)[0][1] == []
    assert way.collect(1)[0][1] == []  # the deadline of slot 1 is 14 ms
    assert way.collect(2)[0][1] == [(0, (1.0,))]


def test_a_newer_packet_takes_the_place_of_one_that_waits_and_not_of_one_that_is_being_sent() -> None:
    seen: list[Transmission] = []
    way = to_controller(bus_of([*busy(0, 9_000_000), Due(9_000_000, 3, CanFrame(identifier=0x11))], seen=seen))
    way.offer(0, 0, (1.0,))
    way.collect(0)
    way.offer(0, 1, (2.0,))  # packet 0 is on the bus
    draws, arrivals = way.collect(1)[0]
    first = next(each for each in seen if each.waiting.frame.identifier == 0x100)
    assert RATES.ns(first.start) < T < RATES.ns(first.end)
    assert arrivals == [(1, (2.0,))] and (SUPERSEDED, 0) in [(draw.reason, draw.packet_slot) for draw in draws]
    way = to_controller(bus_of(busy(0, 12_000_000)))
    way.offer(0, 0, (1.0,))
    way.collect(0)
    way.offer(0, 1, (2.0,))
    draws, arrivals = way.collect(1)[0]
    assert arrivals == [(1, (2.0,))] and (REPLACED, 0) in [(draw.reason, draw.packet_slot) for draw in draws]


def test_a_fifo_sends_every_packet_though_newer_ones_wait() -> None:
    seen: list[Transmission] = []
    way = to_controller(bus_of(busy(0, 20_000_000), overwrite=False, seen=seen))
    for k in range(3):
        way.offer(0, k, (float(k),))
        way.collect(k)
    own = [each for each in seen if each.waiting.frame.identifier == 0x100]
    assert [np.frombuffer(each.waiting.frame.data, "<f4").tolist() for each in own] == [[0.0], [1.0], [2.0]]


def test_both_directions_are_on_one_bus_and_delay_each_other() -> None:
    bus = bus_of([])
    up = to_controller(bus)
    way = TimedBusWay(bus, [channel()], [lambda packet: value_frames(0x140, [0.0] * 150, fd=False)], first=1, back=True)
    down = OneWay(way)
    up.offer(0, 0, (1.0,))
    up.collect(0)
    down.offer(0, "answer")  # 75 frames of a millisecond each
    assert down.collect(0)[1] == []
    up.offer(0, 1, (2.0,))
    assert up.collect(1)[0][1] == [(1, (2.0,))]  # a lower identifier waits for one frame at most
    for k in range(1, 8):
        down.collect(k)
    assert down.collect(8)[1] == [(0, "answer")]


def test_traffic_comes_in_order_with_its_jitter_and_its_bytes_from_its_own_stream() -> None:
    frame = CanFrame(identifier=0x20, data=bytes(4))
    message = Periodic(node=1, frame=frame, period_ns=1000, offset_ns=500, jitter_ns=300, random=True)
    found = [next(source) for source in [message.frames(np.random.default_rng(1))] for _ in range(200)]
    late = [due.at_ns - 500 - 1000 * n for n, due in enumerate(found)]
    assert min(late) >= 0 and max(late) <= 300 and len(set(late)) > 20
    assert len({due.frame.data for due in found}) == 200
    again = message.frames(np.random.default_rng(1))
    assert [next(again) for _ in range(200)] == found
    other = Periodic(node=2, frame=CanFrame(identifier=0x21), period_ns=700)
    merged = list(Traffic([message.frames(np.random.default_rng(1)), other.frames(np.random.default_rng(2))]).until(50_000))
    assert [due.at_ns for due in merged] == sorted(due.at_ns for due in merged) and len(merged) == 50 + 72


def test_a_long_packet_fills_frames_of_64_bytes_and_the_last_is_padded_to_a_length_of_can_fd() -> None:
    values = [float(n) for n in range(19)]
    first, last = value_frames(0x100, values, fd=True)
    assert (first.identifier, last.identifier, len(first.data), len(last.data)) == (0x100, 0x101, 64, 12)
    assert first.data + last.data == struct.pack("<19f", *values)
    assert [len(frame.data) for frame in value_frames(0x100, values[:3] * 3, fd=True)] == [48]  # not 36
