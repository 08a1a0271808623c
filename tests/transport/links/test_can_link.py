"""The CAN link over python-can's in-process bus: fragments, foreign frames, and a bus that fails."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from errno import EAFNOSUPPORT, EIO, ENETDOWN, ENOBUFS, ENODEV, EPERM
from itertools import permutations
from pathlib import Path
from time import monotonic
from uuid import uuid4

import can
import pytest

from transport import Role, TransportError, open_link
from transport.links import can_open
from transport.links.can_link import CanLink
from transport.links.can_open import open_can
from transport.links.contract import control, sensor
from transport.links.python_can import MessageFrames

Node = can.BusABC


@pytest.fixture(params=[True, False], ids=["fd", "classic"])
def fd(request: pytest.FixtureRequest) -> bool:
    return bool(request.param)


@pytest.fixture
def channel() -> str:
    return uuid4().hex


@pytest.fixture
def node(channel: str, fd: bool) -> Iterator[Node]:
    """A third participant."""
    with can.Bus(channel, interface="virtual", protocol=can.CanProtocol.CAN_FD if fd else can.CanProtocol.CAN_20) as bus:
        yield bus


@pytest.fixture
def controller(channel: str, fd: bool) -> Iterator[CanLink]:
    with open_can(f"can:virtual:{channel}?fd={fd:d}&base=0x200", "controller") as link:
        yield link


def fragments(packet: bytes, fd: bool) -> list[can.Message]:
    step, first = (64, 0x200) if fd else (8, 0x280)
    return [
        can.Message(arbitration_id=first + i, is_extended_id=False, is_fd=fd, data=packet[i * step : (i + 1) * step])
        for i in range(-(-len(packet) // step))
    ]


LONG = sensor(5, 40)  # 176 bytes: 3 CAN FD frames, 22 classic ones


def test_a_packet_in_fragments_arrives_whole(node: Node, controller: CanLink, fd: bool) -> None:
    for packet in (sensor(1), LONG, sensor(2)):
        for message in fragments(packet, fd):
            node.send(message)
        assert controller.receive(1) == packet
    assert controller.counters.malformed == 0 and controller.counters.received == 3


def test_fragments_lost_doubled_or_out_of_order_never_make_a_packet(node: Node, controller: CanLink, fd: bool) -> None:
    parts = fragments(sensor(1, 40), fd)[:3]
    whole = fragments(LONG, fd)
    cases = [list(order) + whole[3:] for order in permutations(whole[:3]) if order != tuple(whole[:3])]
    cases += [whole[:k] + whole[k + 1 :] for k in range(len(whole))]
    cases += [whole[:1] + whole[1:2] * 2 + whole[2:], parts[:1] + whole[1:], parts[:2] + whole[2:]]
    for number, case in enumerate(cases):
        for message in [*case, *fragments(sensor(number), fd)]:
            node.send(message)
        assert controller.receive(1) == sensor(number)
        assert controller.receive(0) is None
    assert controller.counters.malformed >= len(cases)


def test_the_last_fragment_may_be_padded(node: Node, controller: CanLink) -> None:
    fd = controller._step == 64
    packet = sensor(3, 1)  # 20 bytes: two whole classic frames and a half
    *head, last = fragments(packet, fd)
    last.data = last.data + bytes(4)
    last.dlc = len(last.data)
    for message in [*head, last]:
        node.send(message)
    got = controller.receive(1)
    assert got is not None and got[: len(packet)] == packet and not any(got[len(packet) :])


def test_foreign_error_and_remote_frames_are_counted_and_skipped(node: Node, controller: CanLink, fd: bool) -> None:
    first = 0x200 if fd else 0x280
    node.send(can.Message(arbitration_id=0x7FF, is_extended_id=False))
    node.send(can.Message(arbitration_id=first + 0x40, is_extended_id=False, data=control(1)[:8]))
    node.send(can.Message(arbitration_id=first, is_extended_id=True, data=sensor(1)[:8]))
    node.send(can.Message(arbitration_id=first, is_extended_id=False, is_remote_frame=True, dlc=8))
    node.send(can.Message(arbitration_id=first, is_extended_id=False, is_error_frame=True, data=bytes(8)))
    if fd:
        node.send(can.Message(arbitration_id=first, is_extended_id=False, data=sensor(1)[:8]))
    for message in fragments(sensor(9), fd):
        node.send(message)
    assert controller.receive(1) == sensor(9)
    assert (controller.counters.malformed, controller.counters.errors) == (1 + fd, 1)


def test_garbage_on_our_identifiers_never_raises(node: Node, controller: CanLink, fd: bool) -> None:
    first = 0x200 if fd else 0x280
    for size in range(65 if fd else 9):
        for index in (0, 1, 63):
            data = bytes((7 * index + i) & 0xFF for i in range(size))
            node.send(can.Message(arbitration_id=first + index, is_extended_id=False, is_fd=fd, data=data))
            controller.receive(0)
    for message in fragments(sensor(9), fd):
        node.send(message)
    assert controller.receive(1) == sensor(9)


def test_a_packet_beyond_all_fragments_is_dropped_and_counted(controller: CanLink, fd: bool) -> None:
    controller.send(bytes(64 * (64 if fd else 8) + 8))
    assert (controller.counters.dropped, controller.counters.sent) == (1, 0)


def test_two_links_with_different_bases_share_a_bus(channel: str) -> None:
    uris = [f"can:virtual:{channel}?base={base}" for base in ("0x100", "0x300")]
    ends = [(open_link(uri, "rig"), open_link(uri, "controller")) for uri in uris]
    for number, (rig, controller) in enumerate(ends):
        rig.send(sensor(number))
        controller.send(control(number))
    for number, (rig, controller) in enumerate(ends):
        assert (controller.receive(1), controller.receive(0)) == (sensor(number), None)
        assert (rig.receive(1), rig.receive(0)) == (control(number), None)
        rig.close()
        controller.close()


class FailingBus(can.BusABC):
    """A bus that raises what it is given, as interfaces do when they fail."""

    def __init__(self, faults: list[Exception]) -> None:
        self.faults = faults
        self.sent: list[can.Message] = []
        super().__init__(channel="failing")

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        if self.faults:
            raise self.faults.pop(0)
        self.sent.append(msg)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if self.faults:
            raise self.faults.pop(0)
        if self.sent:
            message = self.sent.pop(0)
            message.arbitration_id ^= 0x40
            return message, True
        return None, True


@pytest.mark.parametrize(
    "fault",
    [
        can.CanOperationError("down", ENETDOWN),
        can.CanOperationError("full", ENOBUFS),
        can.CanOperationError("Transmit buffer full"),
        can.CanTimeoutError("late"),
        OSError(EIO, "unplugged"),
        ValueError("file descriptor cannot be a negative integer (-1)"),
    ],
    ids=lambda fault: f"{type(fault).__name__}-{getattr(fault, 'error_code', None)}",
)
def test_a_fault_of_the_bus_is_counted_and_survived(fault: Exception) -> None:
    """Only a bus whose socket is closed is joined anew: what is full or down comes back by itself."""
    bus, joined = FailingBus([fault] * 3), []

    def join() -> MessageFrames:
        joined.append(bus)
        return MessageFrames(bus, fd=True)

    with CanLink("can:failing", "rig", join) as link:
        link.send(sensor(1))
        assert link.receive(0.001) is None
        link.send(sensor(1))
        assert (link.counters.errors, link.counters.dropped, link.counters.sent) == (3, 2, 0)
        assert (len(joined) > 1) is isinstance(fault, ValueError)
        bus._is_shutdown = False
        link.send(sensor(2))
        assert link.receive(0.01) == sensor(2)
        assert link.counters.sent == link.counters.received == 1


def test_a_datagram_that_is_no_frame_is_malformed_and_no_fault_of_the_bus() -> None:
    """Over udp_multicast any process may send it: a text in the place of a flag ended the rig, or took a gigabyte.

    For a fault of the bus a link pauses for 10 ms: a hundred datagrams a second would leave it no time.
    """
    said = {"arbitration_id": 0x140, "is_fd": True, "is_extended_id": False, "data": control(1)}
    odd = [{"is_remote_frame": "x"}, {"is_error_frame": None, "arbitration_id": 320.0}, {"is_extended_id": {}, "is_fd": 3}]
    unreadable = can.CanOperationError("could not unpack received message")
    unreadable.__cause__ = KeyError("dlc")
    bus = FailingBus([unreadable] * 20)
    bus.sent = [can.Message(**{**said, **each}) for each in odd]  # type: ignore[arg-type]
    for each in bus.sent:
        each.arbitration_id = each.arbitration_id if isinstance(each.arbitration_id, float) else each.arbitration_id ^ 0x40
    with CanLink("can:failing", "rig", lambda: MessageFrames(bus, fd=True)) as link:
        while bus.faults or bus.sent:
            link.receive(0.1)
        assert (link.counters.malformed, link.counters.errors, link.counters.received) == (22, 0, 1)


def test_a_loop_that_polls_a_failing_bus_does_not_spin() -> None:
    bus = FailingBus([can.CanOperationError("down", ENETDOWN)] * 1000)
    with CanLink("can:failing", "rig", lambda: MessageFrames(bus, fd=True)) as link:
        begin = monotonic()
        while monotonic() < begin + 0.1:
            link.receive(0.1)
        assert link.counters.errors <= 15


def test_an_interface_that_vanished_is_joined_anew_when_it_is_back() -> None:
    buses = [FailingBus([can.CanOperationError("gone", ENODEV)] * 1000), FailingBus([])]
    tries = 0

    def join() -> MessageFrames:
        nonlocal tries
        tries += 1
        if tries in (2, 3):
            raise OSError(ENODEV, "No such device")
        return MessageFrames(buses[0] if tries == 1 else buses[1], fd=True)

    with CanLink("can:failing", "rig", join) as link:
        for _ in range(60):
            link.send(sensor(1))
        assert tries == 4 and buses[1].sent
        assert link.counters.errors == link.counters.dropped == 60 - link.counters.sent


def test_bytes_of_any_length_travel_padded(channel: str) -> None:
    with (
        open_link(f"can:virtual:{channel}", "rig") as rig,
        can.Bus(channel, interface="virtual", protocol=can.CanProtocol.CAN_FD) as node,
    ):
        rig.send(b"\xee" * 13)
        message = node.recv(1)
        assert message is not None and bytes(message.data) == b"\xee" * 13 + bytes(3)


def test_a_motor_packet_is_one_frame_with_bit_rate_switch(channel: str) -> None:
    with can.Bus(channel, interface="virtual", protocol=can.CanProtocol.CAN_FD) as node:
        with open_link(f"can:virtual:{channel}", "rig") as rig:
            rig.send(sensor(1))
        message = node.recv(1)
        assert message is not None and node.recv(0) is None
        assert (message.arbitration_id, message.is_fd, message.bitrate_switch, message.dlc) == (0x100, True, True, 48)
        assert bytes(message.data) == sensor(1)


@pytest.mark.parametrize("interface", ["virtual", "hil"])
@pytest.mark.parametrize(("role", "other"), [("rig", "controller"), ("controller", "rig")])
def test_a_second_one_in_its_role_is_refused_until_the_first_has_gone(
    channel: str, interface: str, role: Role, other: Role
) -> None:
    uri = f"can:{interface}:{channel}"
    with open_link(uri, role):
        with pytest.raises(TransportError, match=f"is another {role} running there"):
            open_link(uri, role)
        open_link(f"{uri}?base=0x200", role).close()  # other identifiers: two loops share the bus
        open_link(uri, other).close()
    open_link(uri, role).close()



def test_a_back_end_without_its_driver_is_refused_in_one_line(channel: str) -> None:
    program = f"""
import logging, can
from transport import Role, TransportError, open_link
def broken(**_):
    logging.getLogger("can.kvaser").warning("Kvaser canlib is unavailable.")
    raise NameError("name 'canOpen' is not\\ndefined.")
can.Bus = broken
for _ in range(2):  # the claim is let go
    try:
        open_link("can:kvaser:{channel}", "rig")
    except TransportError as error:
        print(error)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    one, other = done.stdout.splitlines()
    assert "name 'canOpen' is not defined; is the driver of kvaser installed" in one and other == one
    assert done.stderr == ""


@pytest.mark.parametrize(
    ("mtu", "flags", "remedy"), [("72", "0x1002", "vcan9 is down: ip link set vcan9 up"), ("16", "0x1003", "mtu 72")]
)
def test_an_interface_that_is_down_or_too_narrow_is_refused_with_the_remedy(
    mtu: str, flags: str, remedy: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("transport.links.can_open._NETWORK", tmp_path)
    (tmp_path / "vcan9").mkdir()
    (tmp_path / "vcan9" / "mtu").write_text(mtu)
    (tmp_path / "vcan9" / "flags").write_text(flags)
    with pytest.raises(TransportError, match=remedy):
        open_link("can:socketcan:vcan9", "rig")


@pytest.mark.parametrize(
    ("interface", "channel", "error", "remedy"),
    [
        ("socketcan", "vcan0", OSError(EAFNOSUPPORT, ""), "; this kernel has no CAN: use can:hil:rig0, or run inside"),
        ("socketcan", "vcan0", OSError(ENODEV, ""), "; make it as root: ip link add dev vcan0 type vcan && ip link set "),
        ("socketcan", "can0", OSError(ENODEV, ""), "; is can0 there? (ip link)"),
        ("socketcan", "can0", can.CanError("", ENODEV), "; is can0 there? (ip link)"),
        ("socketcan", "can0", OSError(EPERM, ""), None),
        ("udp_multicast", "239.0.0.1", OSError(ENODEV, ""), "; needs a multicast route: "),
        ("virtual", "a", OSError(ENODEV, ""), None),
        ("kvaser", "0", ValueError("bitrate"), None),
        ("kvaser", "0", TypeError("bitrate"), None),
        ("kvaser", "0", OSError(EAFNOSUPPORT, ""), "; is the driver of kvaser installed, and its device there?"),
    ],
)
def test_what_an_interface_says_is_followed_by_what_helps(
    interface: str, channel: str, error: Exception, remedy: str | None
) -> None:  # fmt: skip
    said = can_open.remedy(interface, channel, error)
    assert said.startswith(remedy) if remedy else said == ""


@pytest.mark.parametrize("options", ["", "?fd=0"], ids=["fd", "classic"])
def test_what_a_full_queue_loses_is_counted_at_both_ends(channel: str, options: str) -> None:
    uri = f"can:hil:{channel[:20]}{options}"
    with open_link(uri, "rig") as rig, open_link(uri, "controller") as controller:
        for number in range(3000):
            rig.send(sensor(number))
        assert rig.counters.dropped > 0 and rig.counters.sent + rig.counters.dropped == 3000
        empty = 0
        while empty < 3:  # a look ends early on a machine that is busy elsewhere
            empty = 0 if controller.receive(0) is not None else empty + 1
        assert controller.counters.received <= rig.counters.sent
        rig.send(sensor(1))
        assert controller.receive(1) == sensor(1)
        assert controller.counters.dropped >= rig.counters.dropped  # in frames


def test_garbage_on_the_controllers_identifier_is_malformed_over_every_frame(node: Node, controller: CanLink, fd: bool) -> None:
    """One count for it, over CAN FD as over classic CAN: the link's own."""
    first, tried = 0x200 if fd else 0x280, 0
    for data in (b"", b"no", b"garbage!", *([bytes(64), sensor(1)[:24], b"\xff" * 48] if fd else [])):
        node.send(can.Message(arbitration_id=first, is_extended_id=False, is_fd=fd, data=data))
        assert controller.receive(0.05) is None
        tried += 1
    for message in fragments(sensor(9), fd):
        node.send(message)
    assert controller.receive(1) == sensor(9)
    assert controller.counters.malformed >= (tried if fd else 1) and controller.counters.received == 1


def test_a_bus_of_ours_is_opened_and_used_without_python_can(channel: str) -> None:
    program = f"""
import sys
from transport import open_link
with open_link("can:hil:{channel[:20]}?bitrate=500k&timed=1", "rig") as rig, \\
     open_link("can:hil:{channel[:20]}?bitrate=500k&timed=1", "controller"):
    rig.send(b"x")
assert "can" not in sys.modules and "difflib" not in sys.modules
"""
    subprocess.run([sys.executable, "-c", program], check=True)
