"""Faults of the `hil` bus with time between real processes, and what a python-can program sees of them, as on hardware."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from time import monotonic_ns

import can
import pytest

from tests.links.test_timed_bus import bus, message, received
from tests.waiting import LIMIT_S, until
from transport import TransportError
from transport.can_bus_model import CanFrame
from transport.can_bus_model.bits import wire_bits
from transport.can_bus_model.disturbances import BusFault
from transport.links import BusStatus
from transport.links.can_datagram import changed, destroyed, location, status

SOON_NS = 10**9
FOR_EVER_NS = 10**15
CONTROLLER, BUS_OFF, RESTARTED, BUS_ERROR = 0x004, 0x040, 0x100, 0x088


def error_frames(listener: can.BusABC, enough: Callable[[list[can.Message]], bool]) -> list[can.Message]:
    found: list[can.Message] = []
    while not enough(found):
        each = listener.recv(LIMIT_S)
        assert each is not None
        if each.is_error_frame:
            found.append(each)
    return found


def wait_until(ns: int) -> None:
    until(lambda: monotonic_ns() > ns, "the end of the fault")


def kinds(frames: list[can.Message]) -> list[int]:
    return [each.arbitration_id for each in frames]


def test_disturbed_bits_of_chosen_frames_take_their_sender_off_the_bus_and_others_go_on() -> None:
    with bus(bitrate=500_000, berr_reporting=True) as first, bus(bitrate=500_000, berr_reporting=True) as second:
        second.frames.plan([BusFault(monotonic_ns(), FOR_EVER_NS, identifier=0x100)], 0, [])
        first.send(message(0x100))
        seen = error_frames(first, lambda found: BUS_OFF in kinds(found))
        states = [each.data[1] for each in seen if each.arbitration_id == CONTROLLER]
        assert states == [0x08, 0x20]  # error warning and error passive, while sending
        assert first.state is can.BusState.ERROR and second.state is can.BusState.ACTIVE
        broken = [each for each in seen if each.arbitration_id == BUS_ERROR]
        wire = wire_bits(CanFrame(identifier=0x100, data=b"12345678"))
        bit = (len(wire.bits) - 4) // 2
        seen_as = 0x88 if wire.bits[bit] == "0" else 0x90  # its sender could not send a dominant, or a recessive bit
        assert len(broken) == 32 and {bytes(each.data[2:4]) for each in broken} == {bytes((seen_as, 0x0A))}
        heard = error_frames(second, lambda found: kinds(found).count(BUS_ERROR) == 32)
        assert {each.data[2] for each in heard} == {0}
        second.send(message(0x200))  # no participant acknowledges it: the only other participant is off
        until(lambda: second.state is can.BusState.PASSIVE, "error passive")


def test_a_rate_of_bit_errors_breaks_frames_and_all_get_through_in_their_order() -> None:
    with bus(bitrate="1M", berr_reporting=True) as first, bus(bitrate="1M", berr_reporting=True) as second:
        first.frames.plan([BusFault(monotonic_ns(), FOR_EVER_NS, rate=2e-3)], 28, [])
        for n in range(150):
            first.send(message(n))
        got: list[int] = []
        broken = 0
        while len(got) < 150:
            each = second.recv(LIMIT_S)
            assert each is not None
            if each.is_error_frame:
                broken += each.arbitration_id == BUS_ERROR
            else:
                got.append(each.arbitration_id)
        assert got == list(range(150)) and 5 < broken < 150  # of 0.2 an attempt, some 38


def test_a_fault_takes_another_participant_off_the_bus_which_receives_nothing_and_comes_back_when_it_is_over() -> None:
    with bus(bitrate=500_000) as rig, bus(bitrate=500_000) as controller, bus(bitrate=500_000) as listener:
        controller.send(message(0x140))
        assert received(rig, 1)[0].arbitration_id == received(listener, 1)[0].arbitration_id == 0x140
        now = monotonic_ns()
        rig.frames.plan([BusFault(now, now + SOON_NS, off=(0,))], 0, [[0x140, 0x141]])
        until(lambda: controller.state is can.BusState.ERROR, "bus-off")
        rig.send(message(0x100))
        assert received(listener, 1)[0].arbitration_id == 0x100
        controller.send(message(0x141))  # waits
        wait_until(now + SOON_NS)
        until(lambda: controller.state is can.BusState.ACTIVE, "recovery")
        assert received(listener, 1)[0].arbitration_id == 0x141
        seen: list[can.Message] = []
        while (each := controller.recv(0.0)) is not None:
            seen.append(each)
        assert kinds(seen) == [BUS_OFF, CONTROLLER | RESTARTED]  # and no 0x100


def test_a_word_to_look_is_no_frame_and_counts_as_none_that_was_lost() -> None:
    with bus() as first, bus() as second:
        first.frames._poke()
        assert second.recv(0.0) is None and second.lost == 0


def test_a_node_with_restart_ms_comes_back_by_itself_and_one_without_stays_off() -> None:
    for restart_ms in (20, 0):
        with bus(bitrate=500_000, restart_ms=restart_ms) as first, bus(bitrate=500_000) as second:
            over = monotonic_ns() + SOON_NS // 5
            second.frames.plan([BusFault(0, over, identifier=0x100)], 0, [])
            first.send(message(0x100))
            error_frames(first, lambda found: BUS_OFF in kinds(found))
            wait_until(over)
            while restart_ms and (each := received(second, 1)[0]).arbitration_id != 0x100:
                assert each.is_error_frame
            assert (first.state is can.BusState.ERROR) == (not restart_ms)
            left = 1
            while (each := first.recv(0.0)) is not None:
                left += each.arbitration_id == BUS_OFF
            assert left <= (1 + 200 // restart_ms if restart_ms else 1)  # each time so long from bus-off to the way back


def test_two_participants_with_one_identifier_and_other_data_collide_until_one_is_passive_and_both_get_through() -> None:
    with bus(bitrate="5k") as first, bus(bitrate="5k") as second, bus(bitrate="5k", berr_reporting=True) as listener:
        collided = False

        def round_of_both() -> bool:
            """They begin at once where both are queued while another frame is on the bus, unless the machine stalls."""
            nonlocal collided
            for sender, identifier, data in ((first, 0x050, b""), (first, 0x100, b"\x0f"), (second, 0x100, b"\x8f")):
                sender.send(message(identifier, data))
            found: list[can.Message] = []
            while len([each for each in found if not each.is_error_frame]) < 3:
                each = listener.recv(LIMIT_S)
                assert each is not None
                found.append(each)
            assert {bytes(each.data) for each in found if not each.is_error_frame} == {b"", b"\x0f", b"\x8f"}
            errors = kinds([each for each in found if each.is_error_frame]).count(BUS_ERROR)
            assert collided or errors in (0, 16)  # until one is passive
            collided = collided or errors > 0
            return collided

        until(round_of_both, "a collision")


def test_the_very_same_frame_of_two_is_received_once_and_both_have_sent_it() -> None:
    with bus(bitrate="5k") as first, bus(bitrate="5k") as second, bus(bitrate="5k") as listener:
        heard: list[int] = []

        def round_of_both() -> bool:
            for sender, identifier in ((first, 0x050), (first, 0x100), (second, 0x100), (first, 0x200), (second, 0x201)):
                sender.send(message(identifier))
            heard.clear()
            while len({0x200, 0x201} & set(heard)) < 2:
                heard.extend(each.arbitration_id for each in received(listener, 1))
            return heard.count(0x100) == 1

        until(round_of_both, "one frame of two senders")
        assert sorted(heard) == [0x050, 0x100, 0x200, 0x201]
        assert not first.frames.timed._items and not second.frames.timed._items  # type: ignore[union-attr]


def test_a_rate_that_times_nothing_is_said_once() -> None:
    with warnings.catch_warnings(record=True) as reported:
        warnings.simplefilter("default")
        for _ in range(3):
            can.Bus("t", interface="hil", bitrate=500_000).shutdown()
    said = "hil: bitrate times nothing on this bus; add timed=True for a bus that takes time"
    assert [str(each.message) for each in reported] == [said]


def test_a_bus_without_time_has_no_faults_and_an_impossible_restart_is_refused() -> None:
    with can.Bus("t", interface="hil") as untimed, pytest.raises(TransportError, match="join it with timed=True"):
        untimed.frames.plan([], 0, [])  # type: ignore[attr-defined]
    with pytest.raises(can.CanInitializationError, match="restart_ms: -1, expected milliseconds, 0 to 1000000"):
        bus(restart_ms=-1)


def test_every_bit_of_a_frame_lies_in_a_field_in_the_order_of_the_frame() -> None:
    order = [0x03, 0x02, 0x06, 0x04, 0x05, 0x07, 0x0F, 0x0E, 0x0C, 0x0D, 0x09, 0x0B, 0x0A, 0x08, 0x18, 0x19, 0x1B, 0x1A]
    frame = CanFrame(identifier=0x1F00FF00, data=bytes(8), extended=True)
    fields = [location(frame, bit) for bit in range(len(wire_bits(frame).bits) - 3)]
    assert list(dict.fromkeys(fields)) == order and fields.count(0x1A) == 7 and fields.count(0x0A) > 64  # with its stuff bits


@pytest.mark.parametrize(
    ("frame", "fields"),
    [
        (CanFrame(identifier=0x555, data=b"U" * 8),
         ((1, 0x03), (8, 0x02), (3, 0x06), (1, 0x0C), (1, 0x05), (1, 0x09), (4, 0x0B))),
        (CanFrame(identifier=0x555, data=b"U" * 8, fd=True, bitrate_switch=True),
         ((1, 0x03), (8, 0x02), (3, 0x06), (1, 0x0C), (1, 0x05), (4, 0x09), (4, 0x0B))),
        (CanFrame(identifier=0x15555555, data=b"U" * 8, extended=True),
         ((1, 0x03), (8, 0x02), (3, 0x06), (1, 0x04), (1, 0x05), (5, 0x07), (8, 0x0F), (5, 0x0E), (1, 0x0C), (1, 0x0D), (1, 0x09),
          (4, 0x0B))),
    ],
    ids=["base", "fd", "extended"],
)  # fmt: skip
def test_fields_are_as_long_as_in_the_standard(frame: CanFrame, fields: tuple[tuple[int, int], ...]) -> None:
    """ISO 11898-1; identifiers and data are chosen so that no stuff bit stands before the checksum."""
    expected = [field for size, field in (*fields, (64, 0x0A)) for _ in range(size)]
    assert [location(frame, bit) for bit in range(len(expected) + 1)] == [*expected, 0x08]


def test_a_state_is_that_of_the_larger_counter_and_an_unanswered_frame_says_so() -> None:
    assert [changed("active", "warning", *counters).data[1] for counters in ((96, 0), (0, 96), (100, 100))] == [0x08, 0x04, 0x0C]
    assert changed("warning", "passive", 96, 130).data[1] == 0x10  # not the transmitter
    assert changed("passive", "warning", 127, 0).data[1] == 0x08 and changed("warning", "active", 95, 3).data[1] == 0x40
    frame = CanFrame(identifier=0x100)
    unanswered = destroyed(frame, wire_bits(frame).ack_slot, sender=True)
    assert (unanswered.kind, unanswered.data[3]) == (0x0A8, 0x19)


@pytest.mark.parametrize(
    ("kind", "level", "state"),
    [
        (CONTROLLER, 0x10, "passive"), (CONTROLLER, 0x20, "passive"), (CONTROLLER, 0x24, "passive"),
        (CONTROLLER, 0x04, "warning"),
        (CONTROLLER, 0x08, "warning"), (CONTROLLER, 0x48, "warning"), (CONTROLLER, 0x40, "active"), (CONTROLLER, 0x01, None),
        (CONTROLLER, 0x80, None), (RESTARTED, 0x00, "active"), (RESTARTED, 0x03, "active"), (BUS_OFF, 0x00, "off"),
        (BUS_OFF, 0x20, "off"), (BUS_ERROR, 0x20, None),
    ],
)  # fmt: skip
def test_an_error_frame_says_the_worst_state_that_its_bits_name_or_none(kind: int, level: int, state: str | None) -> None:
    data = bytes((0, level, 0, 0, 0, 0, 130, 7))
    said = status(kind, data)
    assert said == (None if state is None else BusStatus(state, 130, 7))  # type: ignore[arg-type]
    assert status(kind, data[:7]) is None


def test_a_change_of_state_is_read_as_it_was_said() -> None:
    for before, state, tec, rec in (("active", "warning", 96, 3), ("warning", "passive", 3, 128), ("off", "active", 0, 0)):
        error = changed(before, state, tec, rec)  # type: ignore[arg-type]
        assert status(error.kind, error.data) == BusStatus(state, tec, rec)  # type: ignore[arg-type]
