"""What a real CAN interface does to a link: frames on the wire, error frames, a full queue, going down, vanishing."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from time import monotonic

import can
import pytest

from tests.waiting import until
from transport import Link, open_link
from transport.links.contract import SEND_LIMIT_S, control, expect, sensor

pytestmark = pytest.mark.vcan

BUS = "vcanf"  # not vcan0, which others use: these tests take the interface down

Ends = tuple[Link, Link]


def ip(*args: str) -> None:
    subprocess.run(["ip", "link", *args], check=True, capture_output=True, text=True)


def add_bus() -> None:
    ip("add", "dev", BUS, "type", "vcan")
    ip("set", BUS, "mtu", "72", "up")


@pytest.fixture
def bus() -> Iterator[str]:
    """A vcan of the test's own, CAN FD, up."""
    try:
        add_bus()
    except (subprocess.CalledProcessError, FileNotFoundError) as why:
        pytest.skip(f"cannot make a vcan here ({why}); `hil vcan` can")
    yield BUS
    subprocess.run(["ip", "link", "del", BUS], capture_output=True)


@pytest.fixture(params=["", "?fd=0"], ids=["fd", "classic"])
def ends(bus: str, request: pytest.FixtureRequest) -> Iterator[Ends]:
    uri = f"can:socketcan:{bus}{request.param}"
    with open_link(uri, "rig") as rig, open_link(uri, "controller") as controller:
        yield rig, controller


@pytest.fixture
def monitor(bus: str) -> Iterator[can.BusABC]:
    """A third node, as candump would be."""
    with can.Bus(bus, interface="socketcan", fd=True) as node:
        yield node


def both_ways(ends: Ends, seq: int) -> None:
    rig, controller = ends
    rig.send(sensor(seq))
    controller.send(control(seq))
    expect(controller, sensor(seq))
    expect(rig, control(seq))


def frames(monitor: can.BusABC) -> list[can.Message]:
    found = []
    while (message := monitor.recv(0.05)) is not None:
        found.append(message)
    return found


def test_fd_packet_is_one_frame_with_bit_rate_switch(bus: str, monitor: can.BusABC) -> None:
    with open_link(f"can:socketcan:{bus}", "rig") as rig:
        rig.send(sensor(1))
    (frame,) = frames(monitor)
    assert (frame.arbitration_id, frame.is_extended_id, frame.is_fd, frame.bitrate_switch) == (0x100, False, True, True)
    assert bytes(frame.data) == sensor(1)
    assert frame.dlc == 48  # 36 bytes and one value, rounded up to a length that CAN FD has


def test_classic_packet_is_frames_of_eight_bytes_in_order(bus: str, monitor: can.BusABC) -> None:
    with open_link(f"can:socketcan:{bus}?fd=0", "controller") as controller:
        controller.send(control(1))
    got = frames(monitor)
    assert [frame.arbitration_id for frame in got] == [0x1C0 + i for i in range(len(got))]
    assert not any(frame.is_fd for frame in got)
    assert b"".join(bytes(frame.data) for frame in got) == control(1)


def test_classic_node_is_not_disturbed_by_fd_frames(bus: str) -> None:
    """The kernel hides FD frames from a socket that has not asked for them."""
    with can.Bus(bus, interface="socketcan", fd=False) as classic, open_link(f"can:socketcan:{bus}", "rig") as rig:
        rig.send(sensor(1))
        assert classic.recv(0.1) is None


def test_error_frames_are_counted_and_packets_go_on(ends: Ends, monitor: can.BusABC) -> None:
    rig, controller = ends
    for reason in (0x040, 0x004, 0x200):  # bus off, controller problem, and one that does not exist
        monitor.send(can.Message(arbitration_id=reason, is_error_frame=True, data=bytes(8)))
    both_ways(ends, 1)
    assert rig.counters.errors == controller.counters.errors == 3
    assert rig.counters.malformed == controller.counters.malformed == 0


def test_error_frame_between_fragments_costs_no_packet(bus: str, monitor: can.BusABC) -> None:
    with open_link(f"can:socketcan:{bus}?fd=0", "controller") as controller:
        data = sensor(1)
        for i in range(0, len(data), 8):
            frame = can.Message(arbitration_id=0x180 + i // 8, is_extended_id=False, data=data[i : i + 8])
            monitor.send(frame)
            monitor.send(can.Message(arbitration_id=0x004, is_error_frame=True, data=bytes(8)))
        expect(controller, data)
        assert controller.counters.malformed == 0


def test_full_queue_drops_and_counts_without_waiting(ends: Ends, bus: str) -> None:
    """A slow bus with a short queue: `send` meets ENOBUFS, as on a real controller that cannot get rid of its frames."""
    rig, controller = ends
    slow = ["tc", "qdisc", "add", "dev", bus, "root", "tbf", "rate", "64kbit", "burst", "200", "limit", "600"]
    subprocess.run(slow, check=True, capture_output=True)
    slowest = 0.0
    for seq in range(1, 301):
        begin = monotonic()
        rig.send(sensor(seq))
        slowest = max(slowest, monotonic() - begin)
    assert slowest < SEND_LIMIT_S
    assert rig.counters.sent + rig.counters.dropped == 300
    assert rig.counters.dropped > 100
    assert rig.counters.errors >= rig.counters.dropped
    subprocess.run(["tc", "qdisc", "del", "dev", bus, "root"], check=True, capture_output=True)
    while controller.receive(0.05) is not None:
        pass
    rig.send(sensor(301))
    expect(controller, sensor(301))


def test_interface_down_drops_and_counts_and_up_again_works(ends: Ends, bus: str) -> None:
    rig, controller = ends
    ip("set", bus, "down")
    rig.send(sensor(1))
    assert rig.counters.dropped == 1
    assert rig.counters.errors >= 1
    assert controller.receive(0.02) is None
    ip("set", bus, "up")
    for _ in range(3):  # each end reads of the fall once, as a pending socket error
        controller.receive(0), rig.receive(0)
    both_ways(ends, 2)


def test_link_outlives_an_interface_that_vanishes_and_comes_back(ends: Ends, bus: str) -> None:
    rig, controller = ends
    ip("del", bus)
    for seq in range(3):
        rig.send(sensor(seq))
        assert controller.receive(0.01) is None
    assert rig.counters.dropped == 3
    add_bus()

    def reopened() -> bool:  # tried now and then only
        rig.send(sensor(9))
        rig.receive(0)
        return controller.receive(0.02) is not None

    until(reopened, "the link to come back")
    while controller.receive(0.02) is not None:
        pass
    both_ways(ends, 10)


def test_waiting_on_a_dead_interface_does_not_spin(ends: Ends, bus: str) -> None:
    _, controller = ends
    ip("set", bus, "down")
    controller.receive(0)  # the pending error
    begin, calls = monotonic(), 0
    while monotonic() - begin < 0.2:
        controller.receive(0.05)
        calls += 1
    assert calls < 100


def test_interface_without_fd_is_refused_with_the_remedy(bus: str) -> None:
    ip("set", bus, "down")
    ip("set", bus, "mtu", "16")
    ip("set", bus, "up")
    with pytest.raises(Exception, match="mtu 72"):
        open_link(f"can:socketcan:{bus}", "rig")
    open_link(f"can:socketcan:{bus}?fd=0", "rig").close()
