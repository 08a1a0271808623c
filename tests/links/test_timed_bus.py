"""The `hil` bus with time: arbitration, exact lengths, errors and bus-off between real processes."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
import threading
from contextlib import suppress
from itertools import pairwise
from time import time
from typing import Any

import can
import pytest

from tests.waiting import until
from transport.can_bus_model import BitRates, CanFrame
from transport.can_bus_model.bits import frame_length
from transport.links import TransportError, can_bus
from transport.links.can_bus import HilBus
from transport.links.can_datagram import FDF, FRAME
from transport.links.opening import open_link

CLOCKS = 1e-3  # s between readings of the two clocks of a stamp, nearly always


def nearly_all_exact(off: list[float]) -> bool:
    """Whether three of four gaps are off by no more than the clocks: a process may be stopped between two readings."""
    return not off or sorted(map(abs, off))[3 * (len(off) - 1) // 4] <= CLOCKS


def bus(**options: Any) -> HilBus:
    joined = can.Bus("t", interface="hil", **{"timed": True, "bitrate": "50k", **options})
    assert isinstance(joined, HilBus)
    return joined


def message(identifier: int, data: bytes = b"12345678", **rest: Any) -> can.Message:
    return can.Message(arbitration_id=identifier, data=data, is_extended_id=False, **rest)


def received(listener: can.BusABC, count: int) -> list[can.Message]:
    found = [listener.recv(20.0) for _ in range(count)]
    assert None not in found
    return found  # type: ignore[return-value]


def test_the_thread_that_sends_is_scheduled_as_its_process_is_once_that_changes(monkeypatch: pytest.MonkeyPatch) -> None:
    scheduled: list[tuple[int, int]] = []
    policy = os.sched_getscheduler(0)
    monkeypatch.setattr(os, "sched_getscheduler", lambda pid: policy)
    monkeypatch.setattr(os, "sched_setscheduler", lambda thread, policy, param: scheduled.append((thread, policy)))
    with bus() as sender, bus() as listener:
        sender.send(message(0x100))
        received(listener, 1)
        assert scheduled == [], "as it was started"
        policy = os.SCHED_FIFO
        for identifier in (0x101, 0x102):
            sender.send(message(identifier))
            received(listener, 1)
    ((thread, given),) = scheduled
    assert given == os.SCHED_FIFO and thread not in (os.getpid(), threading.get_native_id())


def test_frames_that_wait_are_arbitrated_and_follow_each_other_by_exactly_their_bits() -> None:
    """Whatever the machine does meanwhile: who was queued before a frame began and wins over it is never sent after it."""
    queued: dict[int, float] = {}
    identifiers = [0x400, 0x300, 0x100, 0x200, *range(0x3F0, 0x380, -8)]
    with bus() as first, bus() as second, bus() as listener:
        for n, identifier in enumerate(identifiers):
            (first, second)[n % 2].send(message(identifier))
            queued[identifier] = time()
        found = received(listener, len(identifiers))
    found.sort(key=lambda each: each.timestamp)  # a sender that got no processor for 100 ms hands its frames out late
    sent_by = {i: set(identifiers[n % 2 :: 2]) for n, i in enumerate(identifiers)}
    length = {i: sum(frame_length(CanFrame(identifier=i, data=b"12345678"))) / 50_000 for i in identifiers}
    assert sorted(each.arbitration_id for each in found) == sorted(identifiers)
    for n, one in enumerate(found):
        started = one.timestamp - length[one.arbitration_id]
        rest = [each.arbitration_id for each in found[n + 1 :] if each.arbitration_id not in sent_by[one.arbitration_id]]
        if rest and rest[0] < one.arbitration_id:  # the next frame of the other participant would have won
            assert queued[rest[0]] > started - CLOCKS
    pairs = list(pairwise(found))
    more = [after.timestamp - before.timestamp - length[after.arbitration_id] for before, after in pairs]
    assert nearly_all_exact([min(each, 0.0) for each in more])  # none is shorter
    waited = [queued[after.arbitration_id] < before.timestamp for before, after in pairs]
    assert nearly_all_exact([each for each, it in zip(more, waited, strict=True) if it])


def test_can_fd_takes_the_time_of_both_rates() -> None:
    """5 ms a frame: five times what the clocks leave open."""
    rates, queued = BitRates(20_000, 160_000), {}
    with bus(bitrate=20_000, dbitrate="160k") as sender, bus(bitrate=20_000, data_bitrate=160_000) as listener:
        for n in range(20):
            sender.send(message(0x100, bytes([n]) * 64, is_fd=True, bitrate_switch=True))
            queued[n] = time()
        found = received(listener, 20)
    assert [bytes(each.data) for each in found] == [bytes([n]) * 64 for n in range(20)]
    frames = [CanFrame(identifier=0x100, data=bytes([n]) * 64, fd=True, bitrate_switch=True) for n in range(1, 20)]
    lengths = [rates.duration(frame_length(frame)) / 2e9 for frame in frames]
    more = [after.timestamp - before.timestamp - length for (before, after), length in zip(pairwise(found), lengths, strict=True)]
    assert nearly_all_exact([min(each, 0.0) for each in more])
    assert nearly_all_exact([each for n, each in enumerate(more, 1) if queued[n] < found[n - 1].timestamp])  # it waited


@pytest.mark.parametrize("stamp", [float("inf"), float("nan"), -float("inf"), 1e300, -1.0])
def test_a_time_that_is_none_takes_nothing_away_from_who_receives_it(stamp: float) -> None:
    """Any program of this user may send it: the kernel's time takes its place."""
    begin = time()
    with bus() as stranger, bus() as listener, open_link("can:hil:t?timed=1&bitrate=50k", "rig") as rig:
        stranger.frames.mesh.send(FRAME.pack(stamp, 0, 0x140, 8, FDF) + b"garbage!")
        (came,) = received(listener, 1)
        assert begin - 1.0 < came.timestamp < time() + 1.0 and bytes(came.data) == b"garbage!"
        until(lambda: rig.receive(0.1) is None and rig.counters.malformed == 1, "the frame at the rig")
        assert rig.counters.errors == 0


def test_a_bus_without_time_is_active_and_so_is_one_that_was_left() -> None:
    with can.Bus("t", interface="hil") as untimed:
        assert untimed.state is can.BusState.ACTIVE
    left = bus()
    left.shutdown()
    assert left.state is can.BusState.ACTIVE


def test_a_lone_sender_becomes_passive_and_its_frame_goes_when_another_joins() -> None:
    with bus(bitrate=500_000, receive_own_messages=True) as lone:
        assert lone.state is can.BusState.ACTIVE
        lone.send(message(0x100))
        until(lambda: lone.state is can.BusState.PASSIVE, "error passive")
        reported = received(lone, 1)[0]
        while not reported.data[1] & 0x20:
            assert reported.is_error_frame and reported.arbitration_id == 0x004
            reported = received(lone, 1)[0]
        assert reported.data[6] == 128
        with bus(bitrate=500_000) as listener:
            assert received(listener, 1)[0].arbitration_id == 0x100


def test_participants_with_other_rates_disturb_each_other_until_one_is_off_the_bus() -> None:
    with bus(bitrate=500_000) as first, bus(bitrate=250_000) as second:
        first.send(message(0x100))
        until(lambda: first.state is can.BusState.ERROR, "bus-off")
        assert second.recv(0.0) is None
        reported: list[can.Message] = []
        while (each := first.recv(0.0)) is not None:
            reported.append(each)
        assert [each.arbitration_id for each in reported if each.is_error_frame][-1] == 0x040  # CAN_ERR_BUSOFF


def test_a_participant_that_was_killed_acknowledges_nothing_any_more() -> None:
    program = "import can, sys\nbus = can.Bus('t', interface='hil', timed=1, bitrate='500k')\n"
    program += "print('ready', flush=True)\nsys.stdin.read()"
    with bus(bitrate=500_000) as ours, subprocess.Popen(
        [sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:  # fmt: skip
        try:
            assert other.stdout is not None and other.stdout.readline()
            ours.send(message(0x100))
            assert ours.state is can.BusState.ACTIVE
        finally:
            other.kill()
            other.wait()

        def unanswered() -> bool:
            ours.send(message(0x101))
            return ours.state is can.BusState.PASSIVE

        until(unanswered, "an unacknowledged frame")


def test_a_rate_without_time_is_warned_of_and_impossible_ones_are_refused() -> None:
    with pytest.warns(UserWarning, match="bitrate times nothing on this bus; add timed=True"):
        can.Bus("t", interface="hil", bitrate=500_000).shutdown()
    for options, said in (
        ({"bitrate": None}, "bitrate: missing"), ({"bitrate": "fast"}, "bitrate: 'fast', expected bit/s such as 500000"),
        ({"bitrate": 501_000}, "bitrate: 501000 bit/s: no whole part of 80000000 Hz; the nearest possible is 500000"),
        ({"dbitrate": "10k"}, "dbitrate: 10000 bit/s, expected 50000 to"), ({"timed": 2}, "timed: 2, expected True or False"),
    ):  # fmt: skip
        with pytest.raises(can.CanInitializationError, match=said):
            bus(**options)
    with pytest.raises(TransportError, match="bitrate: missing"):
        open_link("can:hil:t?timed=1", "rig")


def test_a_full_transmit_buffer_is_an_error_of_the_sender() -> None:
    with bus() as lone:
        for n in range(1024):
            lone.send(message(n))
        with pytest.raises(can.CanOperationError, match="the transmit buffer is full"):
            lone.send(message(0x7FF))


def test_a_bridge_ends_with_its_interface_and_not_while_it_is_down(monkeypatch: pytest.MonkeyPatch) -> None:
    """It went on without a word where the interface had been deleted, and nothing passed any more."""

    numbers = [errno.ENODEV, errno.ENETDOWN]

    def recv(_: float | None) -> can.Message | None:
        number = numbers.pop()
        raise can.CanOperationError(f"Error receiving: {os.strerror(number)}", number)

    with bus() as controller, can.Bus("if0", interface="hil") as interface:
        monkeypatch.setattr(interface, "recv", recv)
        with pytest.raises(can.CanOperationError, match="No such device"):
            can_bus.bridge(controller, interface)


def test_a_bridge_is_the_controller_of_an_interface_between_its_programs_and_a_bus_that_takes_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """In the place of a kernel's interface: a bus of ours without time."""
    over, looked = threading.Event(), can_bus._received

    def look(each: can.BusABC) -> can.Message | None:
        if over.is_set():
            raise SystemExit
        return looked(each)

    def run() -> None:
        with suppress(SystemExit):
            can_bus.bridge(controller, interface)

    monkeypatch.setattr(can_bus, "_received", look)
    monkeypatch.setattr("transport.links.timed_sender.MOST_WAITING", 4)
    with bus() as controller, can.Bus("if0", interface="hil") as interface, can.Bus("if0", interface="hil") as program:
        thread = threading.Thread(target=run)
        thread.start()
        try:
            with bus() as other:
                program.send(message(0x101))
                (came,) = received(other, 1)
                assert (came.arbitration_id, bytes(came.data)) == (0x101, b"12345678")
                other.send(can.Message(arbitration_id=0x1ABCDEF, data=b"back", is_extended_id=True))
                (came,) = received(program, 1)
                assert (came.arbitration_id, came.is_extended_id, bytes(came.data)) == (0x1ABCDEF, True, b"back")
                program.send(can.Message(arbitration_id=0x004, is_error_frame=True, data=bytes(8)))
                program.send(message(0x102))
                assert received(other, 1)[0].arbitration_id == 0x102, "an error frame of a program is none of the wire"
            for n in range(8):  # nobody acknowledges any more, and four may wait
                program.send(message(0x200 + n))
            full: list[can.Message] = []
            while len(full) < 4:
                full += [each for each in received(program, 1) if each.is_error_frame and each.data[1] == 0x02]
            assert all(each.arbitration_id == 0x004 and len(each.data) == 8 for each in full)
        finally:
            over.set()
            thread.join()
