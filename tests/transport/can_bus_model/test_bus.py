"""The bus in time: who wins when, what errors cost, and who is still on it."""

from __future__ import annotations

import random
from itertools import pairwise

import numpy as np
import pytest
from msgspec.structs import replace

from tests.transport.can_analysis.sae import BOUNDS_MS, SAE
from transport.can_analysis import PeriodicMessage, bus_load, response_times
from transport.can_bus_model import BitRates, CanFrame
from transport.can_bus_model.bits import frame_length, wire_bits
from transport.can_bus_model.bus import CanBus, Transmission
from transport.can_bus_model.disturbances import BitErrors
from transport.can_bus_model.node import CanNode, Waiting

RATES = BitRates(500_000, 2_000_000)
MS = 1_000_000


class Planned:
    """Disturbs a chosen bit of chosen frames, counted from 0."""

    def __init__(self, hits: dict[int, int]) -> None:
        self._hits, self._frame = hits, -1

    def first(self, bits: int, start: int, frame: CanFrame) -> int | None:
        self._frame += 1
        return self._hits.get(self._frame)


def waiting(identifier: int, at: int = 0, data: bytes = b"", tag: object = None) -> Waiting:
    return Waiting(CanFrame(identifier=identifier, data=data), at, tag)


def order(done: list[Transmission]) -> list[int]:
    return [each.waiting.frame.identifier for each in done]


def test_the_lowest_identifier_wins_at_every_idle_instant_and_frames_last_as_long_as_their_bits() -> None:
    bus = CanBus(RATES, [CanNode(), CanNode(), CanNode()])
    for node, identifier in enumerate((0x300, 0x100, 0x200)):
        bus.queue(node, waiting(identifier))
    done = bus.advance(10**9)
    assert order(done) == [0x100, 0x200, 0x300]
    lengths = [sum(frame_length(each.waiting.frame)) * RATES.bit for each in done]
    assert [each.idle - each.start for each in done] == lengths
    assert [each.start for each in done] == [0, lengths[0], lengths[0] + lengths[1]]
    assert [each.waiting.lost for each in done] == [0, 1, 2]


def test_a_frame_queued_when_the_bus_becomes_idle_takes_part_and_half_a_nanosecond_later_does_not() -> None:
    for late, expected in ((0, [0x200, 0x100, 0x300]), (1, [0x200, 0x300, 0x100])):
        bus = CanBus(RATES, [CanNode(), CanNode(), CanNode()])
        bus.queue(0, waiting(0x200))
        first = frame_length(CanFrame(identifier=0x200))
        bus.queue(1, waiting(0x300))
        idle = RATES.duration(first)
        done = bus.advance(idle + late)
        bus.queue(2, waiting(0x100, idle + late))
        assert order(done + bus.advance(10**9)) == expected


def test_fifo_holds_its_best_frame_back_priority_does_not_and_an_overwritten_one_is_never_sent() -> None:
    seen = {}
    for kind in ("fifo", "priority", "overwritten"):
        bus = CanBus(RATES, [CanNode(kind), CanNode()])  # type: ignore[arg-type]
        bus.queue(1, waiting(0x050))
        bus.advance(1)
        replaced = [bus.queue(0, waiting(i, 1, bytes([n]), n)) for n, i in enumerate((0x300, 0x100, 0x300))]
        seen[kind] = [(each.waiting.frame.identifier, each.waiting.tag) for each in bus.advance(10**9)]
        assert [each is not None for each in replaced] == [False, False, kind == "overwritten"]
    assert seen["fifo"] == [(0x050, None), (0x300, 0), (0x100, 1), (0x300, 2)]
    assert seen["priority"] == [(0x050, None), (0x100, 1), (0x300, 0), (0x300, 2)]
    assert seen["overwritten"] == [(0x050, None), (0x100, 1), (0x300, 2)]


def test_an_aborted_frame_is_not_sent_and_one_on_the_bus_gets_through() -> None:
    bus = CanBus(RATES, [CanNode(), CanNode()])
    first, second = waiting(0x10), waiting(0x20)
    bus.queue(0, first)
    bus.queue(0, second)
    bus.advance(1)
    assert bus.abort(0, second) and not bus.abort(0, second) and not bus.abort(0, first)
    assert order(bus.advance(10**9)) == [0x10]


def test_a_disturbed_frame_costs_its_bits_flags_delimiter_and_intermission_and_is_sent_again() -> None:
    frame = CanFrame(identifier=0x123, data=bytes.fromhex("1122334455667788"))
    bus = CanBus(RATES, [CanNode(), CanNode()], Planned({0: 40}))
    bus.queue(0, Waiting(frame, 0))
    first, second = bus.advance(10**9)
    wire = wire_bits(frame).bits
    seen = wire[:40] + ("1" if wire[40] == "0" else "0")
    flags = 12 - (len(seen) - len(seen.rstrip("0")))
    assert 6 <= flags <= 12 and first.error_bit == 40
    assert first.idle - first.start == (41 + flags + 8 + 3) * RATES.bit and second.start == first.idle
    assert second.error_bit is None and (bus.nodes[0].errors.tec, bus.nodes[1].errors.rec) == (7, 0)


def test_a_frame_at_other_bit_rates_is_destroyed_by_an_active_listener_and_passes_a_passive_one() -> None:
    other = BitRates(250_000)
    for listeners, destroyed in (([CanNode(rates=other)], True), ([CanNode(), CanNode()], False)):
        bus = CanBus(RATES, [CanNode(), *listeners])
        bus.queue(0, waiting(0x100))
        first = bus.advance(MS)[0]
        assert (first.error_bit is not None) is destroyed
        assert (bus.nodes[0].errors.tec > 0) is destroyed
    bus = CanBus(RATES, [CanNode(), CanNode(rates=other), CanNode()])
    bus.nodes[1].errors.rec = 128
    bus.queue(0, waiting(0x100))
    assert bus.nodes[1].errors.passive and bus.advance(MS)[0].error_bit is None


def test_an_error_in_the_data_phase_of_can_fd_counts_both_rates() -> None:
    frame = CanFrame(identifier=0x123, data=bytes([0x55] * 64), fd=True, bitrate_switch=True)
    bus = CanBus(RATES, [CanNode(), CanNode()], Planned({0: 217}))
    bus.queue(0, Waiting(frame, 0))
    first = bus.advance(10**9)[0]
    begin = wire_bits(frame).fast[0]
    nominal = begin + 8 + 3
    flags = (first.idle - first.start - nominal * RATES.bit - (218 - begin) * RATES.data_bit) / RATES.bit
    assert flags in range(6, 13)


def test_sixteen_errors_make_a_node_passive_32_put_it_off_the_bus_and_1408_bits_bring_it_back() -> None:
    states: list[tuple[int, int, str]] = []
    bus = CanBus(RATES, [CanNode(), CanNode()], Planned(dict.fromkeys(range(32), 20)))
    bus.status = lambda at, node: states.append((at, node, bus.nodes[node].errors.state))
    bus.queue(0, waiting(0x100))
    done = bus.advance(10**9)
    assert [each.error_bit for each in done] == [20] * 32 + [None]
    assert [state for _, node, state in states if node == 0] == ["warning", "passive", "off", "active"]
    off, back = (at for at, node, state in states if node == 0 and state in ("off", "active"))
    delimiter = 8 * RATES.bit
    assert back - (off - delimiter) == 1408 * RATES.bit and done[-1].start == back
    gaps = [b.start - a.idle for a, b in pairwise(done[:-1])]
    assert gaps == [0] * 15 + [8 * RATES.bit] * 16  # suspended once passive: behind 16 errors


def test_a_lone_node_stops_at_tec_128_repeats_for_ever_and_never_leaves_the_bus() -> None:
    bus = CanBus(RATES, [CanNode()])
    bus.queue(0, waiting(0x100))
    done = bus.advance(RATES.units(100 * MS))
    ack = sum(frame_length(CanFrame(identifier=0x100))) - 12
    assert len(done) > 500 and {each.error_bit for each in done} == {ack}
    assert (bus.nodes[0].errors.tec, bus.nodes[0].errors.state) == (128, "passive")


def test_two_nodes_with_one_identifier_and_other_data_collide_until_one_is_passive_and_then_both_get_through() -> None:
    bus = CanBus(RATES, [CanNode(), CanNode(), CanNode()])
    bus.queue(0, waiting(0x100, data=b"\x0f"))
    bus.queue(1, waiting(0x100, data=b"\x8f"))  # recessive where the other is dominant
    done = bus.advance(10**9)
    broken = [each for each in done if each.error_bit is not None]
    assert len(broken) == 16 and [each.node for each in done[16:]] == [0, 1]
    assert [bus.nodes[i].errors.tec for i in (0, 1)] == [127, 135]


def test_the_very_same_frame_of_two_nodes_is_sent_once() -> None:
    bus = CanBus(RATES, [CanNode(), CanNode(), CanNode()])
    for node in (0, 1):
        bus.queue(node, waiting(0x100, data=b"same"))
    assert len(bus.advance(10**9)) == 1 and not bus.nodes[0].waiting and not bus.nodes[1].waiting


def test_random_bit_errors_hit_as_many_frames_as_their_rate_says_and_repeat_with_their_seed() -> None:
    def counted(seed: int, rate: float) -> tuple[int, int]:
        bus = CanBus(RATES, [CanNode(), CanNode()], BitErrors(rate, np.random.default_rng(seed)))
        hit = sent = 0
        for i in range(4000):
            bus.queue(0, waiting(0x100, RATES.units(i * MS)))
            for each in bus.advance(RATES.units((i + 1) * MS)):
                sent, hit = sent + 1, hit + (each.error_bit is not None)
            bus.nodes[0].errors.tec = bus.nodes[1].errors.rec = 0
        return hit, sent

    assert counted(1, 0.0) == (0, 4000)
    hit, sent = counted(1, 1e-3)
    bits = sum(frame_length(CanFrame(identifier=0x100))) - 4
    expected = 1 - (1 - 1e-3) ** bits
    sigma = (expected * (1 - expected) / sent) ** 0.5
    assert abs(hit / sent - expected) < 5 * sigma  # a false alarm in two millions
    assert counted(1, 1e-3) == (hit, sent) != counted(2, 1e-3)
    with pytest.raises(ValueError, match=r"bit_error_rate: 1\.5"):
        BitErrors(1.5, np.random.default_rng(0))


def simulate(
    messages: list[PeriodicMessage], rates: BitRates, first: list[int], until: int, idle: int = 0
) -> tuple[dict[str, int], int]:
    """Return the longest response of each message in units to the end of intermission, and how long the bus was in use."""
    bus = CanBus(rates, [CanNode("fifo") for _ in messages] + [CanNode()], idle=idle)
    periods = [rates.units(m.period_ns) for m in messages]
    due = sorted((at + period * n, i) for i, (period, at) in enumerate(zip(periods, first)) for n in range(until // period + 1))
    worst, used = dict.fromkeys((m.name for m in messages), 0), 0
    done: list[Transmission] = []
    for at, i in due:
        done += bus.advance(at)
        m = messages[i]
        bus.queue(i, Waiting(CanFrame(identifier=m.identifier), at, (m.name, at), m.frame_length()))
    done += bus.advance(2 * until)
    for each in done:
        name, nominal = each.waiting.tag  # type: ignore[misc]
        worst[name] = max(worst[name], each.idle - nominal)
        used += each.idle - each.start
    return worst, used


def test_the_sae_set_reaches_its_bounds_at_the_critical_instant() -> None:
    rates = BitRates(125_000)
    bounds = response_times(SAE, rates)
    reached = []
    for place, bound in enumerate(bounds):  # all are due at once, just as the longest lower one has begun
        blocked = rates.units(bound.blocking_ns)
        worst, _ = simulate(SAE[: place + 1], rates, [0] * (place + 1), rates.units(100 * MS), idle=blocked)
        reached.append(rates.ns(worst[SAE[place].name] - 3 * rates.bit) / MS)
    assert reached == list(BOUNDS_MS)


@pytest.mark.parametrize(("sets", "until_ms"), [(12, 2000), pytest.param(200, 9000, marks=pytest.mark.slow)])
def test_simulated_random_sets_never_exceed_their_bounds_and_reach_them(sets: int, until_ms: int) -> None:
    rng = random.Random(28)
    frames = reached = 0
    for _ in range(sets):
        rates = BitRates(rng.choice((125_000, 250_000, 500_000)))
        messages = [
            PeriodicMessage(name=str(i), identifier=one, length=rng.randrange(9), period_ns=rng.choice((5, 7, 10, 25, 50)) * MS)
            for i, one in enumerate(rng.sample(range(2048), rng.randrange(3, 16)))
        ]  # every period is a whole number of bits
        while bus_load(messages, rates) >= 1:
            messages.pop()
        bounds = {each.message.name: each for each in response_times(messages, rates)}
        first = [rng.randrange(rates.units(m.period_ns)) for m in messages]
        worst, _ = simulate(messages, rates, first, rates.units(until_ms * MS))
        for name, units in worst.items():
            assert units <= rates.units(bounds[name].intermission_ns or 0)
        frames += sum(until_ms * MS // m.period_ns for m in messages)
        for bound in bounds.values():
            above = [m for m in messages if m.key() <= bound.message.key()]
            worst, _ = simulate(above, rates, [0] * len(above), rates.units(200 * MS), idle=rates.units(bound.blocking_ns))
            reached += worst[bound.message.name] == rates.units(bound.intermission_ns or 0)
            assert worst[bound.message.name] == rates.units(bound.intermission_ns or 0)
    assert frames > 800 * sets and reached > 5 * sets
    if sets == 200:
        assert frames > 1_000_000


def test_the_load_of_the_bus_is_the_analytic_sum() -> None:
    rates = BitRates(125_000)
    _, used = simulate(SAE, rates, [0] * len(SAE), rates.units(10_000 * MS) - 1)
    assert abs(used / rates.units(10_000 * MS) - float(bus_load(SAE, rates))) < 1e-3


def test_more_than_the_whole_bus_runs_and_the_highest_messages_keep_their_bounds() -> None:
    rates = BitRates(125_000)
    full = [replace(each, period_ns=each.period_ns // 2) if each.period_ns == 5 * MS else each for each in SAE]
    assert bus_load(full, rates) > 1
    bounds = {each.message.name: each.intermission_ns for each in response_times(full, rates)}
    worst, _ = simulate(full, rates, [0] * len(full), rates.units(500 * MS))
    assert None in bounds.values()
    assert all(worst[name] <= rates.units(bound) for name, bound in bounds.items() if bound is not None)


@pytest.mark.parametrize("before", ["nobody", "one that left", "one that is off the bus"])
def test_repeats_that_are_left_out_leave_the_bus_as_if_each_had_passed(before: str) -> None:
    """The last eight of 900 repeats; a frame of the same node that is more urgent, and one that joins, end them."""
    ends = []
    for most in (None, 8):
        bus = CanBus(RATES, [CanNode()] + [CanNode(recovers=False)] * (before != "nobody"))
        if before == "one that left":
            bus.leave(1)
        elif before == "one that is off the bus":
            bus.switch_off(1, 0)
        bus.queue(0, waiting(0x200))
        found = [bus.advance(at, most) for at in (3 * MS, 400 * MS, 403 * MS)]
        assert (len(found[1]) < 16) is (most is not None) and len(found[1]) >= 8
        bus.queue(0, waiting(0x100, 403 * MS))
        found.append(bus.advance(404 * MS, most))
        bus.join(CanNode())
        found.append(bus.advance(440 * MS, most))
        assert order(found[-1])[-2:] == [0x100, 0x200] and not bus.sending
        ends.append((found[0], found[1][-8:], found[2][-8:], *found[3:], [node.errors.tec for node in bus.nodes], bus.memory()))
    assert [str(each) for each in ends[0]] == [str(each) for each in ends[1]]


def test_repeats_that_are_disturbed_or_acknowledged_are_not_left_out() -> None:
    alone, heard = CanBus(RATES, [CanNode()], Planned({})), CanBus(RATES, [CanNode(), CanNode()])
    for bus in (alone, heard):
        bus.nodes[0].errors.tec = 128
        bus.queue(0, waiting(0x200))
    assert len(alone.advance(400 * MS, 8)) > 800 and len(heard.advance(400 * MS, 8)) == 1
