"""Bounds slot by slot: every simulated frame lies between them, they are reached, and what they cannot know is said."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from tests.transport.can_analysis.sae import SAE
from transport.can_analysis import PeriodicMessage, response_times
from transport.can_analysis.response_ranges import ResponseRanges, response_ranges
from transport.can_bus_model import BitRates, CanFrame, FrameLength, Periodic, Traffic
from transport.can_bus_model.bits import frame_bounds, frame_length
from transport.can_bus_model.bus import CanBus, CanNode
from transport.can_bus_model.node import Waiting
from transport.errors import FieldError, NotKnown

MS = 1_000_000
RATES = BitRates(125_000)


def measured(messages: list[PeriodicMessage], seconds: float, seed: int) -> dict[tuple[int, int], int]:
    """Response in units of every instance that got through, by (message, instance)."""
    bus = CanBus(RATES, [CanNode() for _ in (*messages, "a listener")])
    sources = []
    for i, own in enumerate(messages):
        frame = CanFrame(identifier=own.identifier, data=bytes(own.length))
        sources.append(
            Periodic(
                node=i, frame=frame, period_ns=own.period_ns, offset_ns=own.offset_ns, jitter_ns=own.jitter_ns,
                random=own.length > 0,
            ).frames(np.random.default_rng([seed, i]))
        )
    ended = []
    for due in Traffic(sources).until(round(seconds * 1e9)):
        at = BitRates.units(due.at_ns)
        ended += bus.advance(at)
        bus.queue(due.node, Waiting(due.frame, at))
    place = {each.identifier: i for i, each in enumerate(messages)}
    count, found = [0] * len(messages), {}
    for each in ended:
        i = place[each.waiting.frame.identifier]
        due_ns = messages[i].offset_ns + count[i] * messages[i].period_ns
        found[i, count[i]] = each.end - BitRates.units(due_ns)
        count[i] += 1
    return found


def random_set(rng: np.random.Generator) -> list[PeriodicMessage]:
    count = int(rng.integers(3, 9))
    found = []
    for i in range(count):
        period = int(rng.choice([5, 10, 20, 40])) * MS
        found.append(PeriodicMessage(
            name=f"m{i}", identifier=0x100 + i, length=int(rng.integers(0, 9)), period_ns=period,
            jitter_ns=int(rng.integers(0, 2)) * int(rng.integers(0, 2 * MS)), offset_ns=int(rng.integers(0, 50)) * MS // 2,
        ))  # fmt: skip
    return found


@pytest.mark.parametrize("seed", range(12))
def test_every_simulated_frame_lies_between_the_bounds_of_its_instance(seed: int) -> None:
    messages = random_set(np.random.default_rng(seed))
    found = response_ranges(messages, RATES)
    if isinstance(found, str):
        assert found == "the messages may need more than the whole bus"
        return
    for (i, instance), response in measured(messages, 0.4, seed).items():
        low, high = found.of(i, instance)
        assert low <= response <= high, (messages[i].name, instance)


def test_bounds_with_known_offsets_are_never_above_those_of_any_offsets() -> None:
    found = response_ranges(SAE, RATES)
    assert isinstance(found, ResponseRanges)
    assert found.hyperperiod_ns == 1000 * MS
    assert sum(found.count) == 1484 - 40  # of the 17 messages alone: no packets of a rig
    for i, bound in enumerate(response_times(SAE, RATES)):
        worst = max(found.of(i, instance)[1] for instance in range(found.count[i]))
        assert RATES.ns(worst) <= (bound.response_ns or 0)
        if i < 14:  # all of them are due together at 0: the critical instant, but for the frame of lower priority before it
            assert RATES.ns(worst) >= (bound.response_ns or 0) - bound.blocking_ns - 10 * MS


def test_frames_of_one_length_leave_nothing_open() -> None:
    """Two messages, due together: the first takes 100 bits less intermission, the second waits for all of the first."""
    bits = FrameLength(100)
    both = [PeriodicMessage(name=n, identifier=i, period_ns=10 * MS, bits=bits, shortest=bits) for i, n in enumerate("AB")]
    found = response_ranges(both, RATES)
    assert isinstance(found, ResponseRanges)
    assert [found.of(0, 7), found.of(1, 3)] == [(97 * RATES.bit,) * 2, (197 * RATES.bit,) * 2]


def test_a_frame_queued_in_the_instant_of_arbitration_takes_part() -> None:
    bits = FrameLength(100)
    low = PeriodicMessage(name="low", identifier=2, period_ns=10 * MS, bits=bits, shortest=bits)
    first = PeriodicMessage(name="first", identifier=1, period_ns=10 * MS, bits=bits, shortest=bits)
    end_ns = RATES.ns(100 * RATES.bit)
    for after_ns, waits in ((0, 100), (1, 0)):
        high = replace(first, name="high", identifier=0, offset_ns=end_ns + after_ns)
        found = response_ranges([first, low, high], RATES)
        assert isinstance(found, ResponseRanges)
        assert found.of(1, 0) == ((197 + waits) * RATES.bit,) * 2


def test_a_shorter_frame_may_delay_another_and_the_bounds_know() -> None:
    """The low one starts before the high one is queued if the frame before it is short, and blocks it then."""
    short, long = FrameLength(60), FrameLength(90)
    first = PeriodicMessage(name="first", identifier=0, period_ns=20 * MS, bits=long, shortest=short)
    low = replace(first, name="low", identifier=2, bits=FrameLength(130), shortest=FrameLength(130))
    high = replace(first, name="high", identifier=1, shortest=long, offset_ns=RATES.ns(80 * RATES.bit))
    set_of = [first, low, high]
    found = response_ranges(set_of, RATES)
    low_first, high_first = (79 + 130 - 80 + 90 - 3) * RATES.bit, (90 - 80 + 90 - 3) * RATES.bit
    least, most = found.of(2, 0)
    assert least <= high_first < low_first <= most + RATES.bit
    only_long = response_ranges([replace(set_of[0], shortest=long), *set_of[1:]], RATES)
    assert only_long.of(2, 0) == (high_first,) * 2  # the longest frame is not the worst case


def test_the_shortest_and_the_longest_frame_hold_every_frame_between_them() -> None:
    rng = np.random.default_rng(7)
    for _ in range(2000):
        fd, extended = bool(rng.integers(2)), bool(rng.integers(2))
        length = int(rng.choice([0, 1, 7, 8, 12, 16, 20, 64] if fd else range(9)))
        switch = fd and bool(rng.integers(2))
        identifier = int(rng.integers(1 << (29 if extended else 11)))
        frame = CanFrame(identifier=identifier, data=rng.bytes(length), extended=extended, fd=fd, bitrate_switch=switch)
        exact = frame_length(frame)
        least, most = frame_bounds(length, extended=extended, fd=fd, bitrate_switch=switch)
        assert least.nominal <= exact.nominal <= most.nominal
        assert least.data <= exact.data <= most.data


def test_what_cannot_be_followed_is_said() -> None:
    def refused(*periods_ns: int) -> str:
        sent = [PeriodicMessage(name=str(i), identifier=i, period_ns=period) for i, period in enumerate(periods_ns)]
        with pytest.raises(NotKnown) as why:
            response_ranges(sent, RATES)
        return str(why.value)

    assert refused(10_000_019, 9_999_991).endswith("and 20000010 frames, at most 20000 are followed")
    assert refused(MS, MS) == "the messages may need more than the whole bus"
    with pytest.raises(FieldError, match="identifier"):
        response_ranges([SAE[0], SAE[0]], RATES)
    with pytest.raises(FieldError, match="offset_ns"):
        replace(SAE[0], offset_ns=-1)
