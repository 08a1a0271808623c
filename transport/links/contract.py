"""What every link must keep, as a check that the author of a link can run: ``check_link(open_pair)``; and the plainest link.

Each check opens a fresh pair of ends in this process and raises `AssertionError` with what was broken.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from threading import Condition
from time import monotonic
from traceback import extract_tb
from typing import Final

from transport.links import Closing, Discoverable, Link, LinkCounters
from transport.links.opening import check_is_link
from transport.packets import ControlPacket, SensorPacket, encode_control, encode_sensor

Pair = tuple[Link, Link]
"""The rig's end and the controller's."""

SEND_LIMIT_S: Final = 3.0
"""One `send` may take 2 ms. A send that blocks takes at least 5 s (zenoh's own limit) or for ever; a sender that a busy machine
does not run takes less."""

_PATIENCE_S: Final = 30.0
"""How long a test waits for what comes in milliseconds on a machine that is not busy."""


QUEUE_LIMIT: Final = 256
"""Packets that wait at one end; what comes on top is dropped and counted by the sender."""


class MemoryLink(Closing):
    """One end of an in-process pair; make both with `memory_pair`. Ends may live in different threads."""

    def __init__(self) -> None:
        self.uri = "memory:"
        self.counters = LinkCounters()
        self.peer: MemoryLink | None = None
        self._queue: deque[bytes] = deque()
        self._arrived = Condition()
        self._waiting = self._closed = False

    def send(self, packet: bytes) -> None:
        peer = self.peer
        if self._closed or peer is None or peer._closed or len(peer._queue) >= QUEUE_LIMIT:
            self.counters.dropped += 1
            return
        peer._queue.append(packet)
        self.counters.sent += 1
        # Looked at after the append: the receiver raises the flag before it looks at the queue a second time.
        if peer._waiting:
            with peer._arrived:
                peer._arrived.notify()

    def receive(self, timeout_s: float) -> bytes | None:
        queue = self._queue
        if not queue and timeout_s > 0 and not self._closed:
            with self._arrived:
                self._waiting = True
                if not queue and not self._closed:
                    self._arrived.wait(timeout_s)
                self._waiting = False
        if not queue or self._closed:
            return None
        self.counters.received += 1
        return queue.popleft()

    def close(self) -> None:
        with self._arrived:
            self._closed = True
            self._arrived.notify_all()


def memory_pair() -> tuple[MemoryLink, MemoryLink]:
    """Return the rig's and the controller's end of a new in-process link.

    >>> rig, controller = memory_pair()
    >>> rig.send(b"y")
    >>> controller.receive(0), rig.receive(0)
    (b'y', None)
    """
    rig, controller = MemoryLink(), MemoryLink()
    rig.peer, controller.peer = controller, rig
    return rig, controller


def sensor(seq: int, outputs: int = 1) -> bytes:
    """Return a sensor packet that differs from every other one of the test."""
    return encode_sensor(SensorPacket(seq, 0, seq * 1_000_000, tuple(seq + i / 8 for i in range(outputs))))


def control(seq: int, rows: int = 2, inputs: int = 1) -> bytes:
    """Return a control packet that differs from every other one of the test."""
    values = tuple(tuple(seq + r + i / 8 for i in range(inputs)) for r in range(rows))
    return encode_control(ControlPacket(seq, seq * 1_000_000, seq * 1_000_000 + 1, 0, 1, values))


def expect(link: Link, packet: bytes) -> None:
    """Wait for this packet to come next."""
    end = monotonic() + _PATIENCE_S
    got = None
    while got is None and monotonic() < end:
        got = link.receive(0.1)
    assert got == packet, f"{link.uri}: received {got!r}, expected {packet!r}"


def meet(rig: Link, controller: Link) -> None:
    """Wait until both ends receive from each other: a link over a network may take a moment to connect."""
    end = monotonic() + _PATIENCE_S
    received = [False, False]
    while not all(received) and monotonic() < end:
        rig.send(sensor(0))
        controller.send(control(0))
        received[0] |= rig.receive(0.02) is not None
        received[1] |= controller.receive(0.02) is not None
    assert all(received), f"{rig.uri}: the two ends do not receive each other's packets within {_PATIENCE_S:g} s"
    while rig.receive(0.05) or controller.receive(0.05):
        pass


def packets_arrive_whole_and_in_order(rig: Link, controller: Link) -> None:
    for first in range(1, 41, 8):  # at once: the frames of one slot
        for seq in range(first, first + 8):
            rig.send(sensor(seq, 1 + seq % 12))
            controller.send(control(seq, 1 + seq % 3, 1 + seq % 3))
        for seq in range(first, first + 8):
            expect(controller, sensor(seq, 1 + seq % 12))
            expect(rig, control(seq, 1 + seq % 3, 1 + seq % 3))


def long_packets_arrive(rig: Link, controller: Link) -> None:
    rig.send(sensor(1, 40))
    expect(controller, sensor(1, 40))
    controller.send(control(1, 16, 5))
    expect(rig, control(1, 16, 5))


def nobody_hears_itself(rig: Link, controller: Link) -> None:
    rig.send(sensor(1))
    controller.send(control(1))
    expect(controller, sensor(1))
    expect(rig, control(1))
    assert rig.receive(0.05) is None and controller.receive(0.05) is None, f"{rig.uri}: a packet came back to its sender"


def looking_does_not_wait_and_waiting_ends(rig: Link, controller: Link) -> None:
    for timeout_s, most_s in ((0.0, 0.5), (-1.0, 0.5), (0.02, 1.0)):
        begin = monotonic()
        assert controller.receive(timeout_s) is None
        taken = monotonic() - begin
        assert taken < most_s, f"{rig.uri}: receive({timeout_s}) took {taken:.3f} s"
        assert taken > timeout_s * 0.9, f"{rig.uri}: receive({timeout_s}) gave up after {taken:.4f} s"


def a_flood_never_blocks_and_every_packet_is_accounted_for(rig: Link, controller: Link) -> None:
    number, slowest = 800, 0.0  # more than what the queues of the shipped links hold
    before = rig.counters.sent + rig.counters.dropped
    for seq in range(1, number + 1):
        begin = monotonic()
        rig.send(sensor(seq))
        slowest = max(slowest, monotonic() - begin)
    assert slowest < SEND_LIMIT_S, f"{rig.uri}: one send took {slowest:.3f} s while the other end did not read"
    counted = rig.counters.sent + rig.counters.dropped - before
    assert counted == number, f"{rig.uri}: {counted} packets sent or dropped, expected {number}"
    previous = 0
    while (packet := controller.receive(0.2)) is not None:
        seq = int.from_bytes(packet[4:8], "little")
        assert seq > previous, f"{rig.uri}: packet {seq} after {previous}"
        previous = seq
    rig.send(sensor(number + 1))
    expect(controller, sensor(number + 1))


def hostile_bytes_do_no_harm(rig: Link, controller: Link) -> None:
    for junk in (b"\xff", bytes(8), bytes(64), b"\x00\x00\x12" + b"\xff" * 40, sensor(1)[:-4], b"\x11" * 700):
        rig.send(junk)
    rig.send(sensor(2))
    end = monotonic() + _PATIENCE_S
    while (got := controller.receive(0.1)) != sensor(2) and monotonic() < end:
        pass
    assert got == sensor(2), f"{rig.uri}: no packet arrived after hostile bytes"


def a_closed_end_drops_and_counts(rig: Link, controller: Link) -> None:
    dropped = rig.counters.dropped
    rig.close()
    rig.close()
    rig.send(sensor(1))
    assert rig.counters.dropped == dropped + 1, f"{rig.uri}: a packet for a closed link is not counted as dropped"
    assert rig.receive(0.01) is None and rig.receive(0) is None
    controller.send(control(1))
    assert controller.receive(0.01) is None


def counters_count(rig: Link, controller: Link) -> None:
    sent, received = rig.counters.sent, controller.counters.received
    for seq in range(1, 4):
        rig.send(sensor(seq))
        expect(controller, sensor(seq))
    assert rig.counters.sent == sent + 3, f"{rig.uri}: {rig.counters}"
    assert controller.counters.received == received + 3, f"{rig.uri}: {controller.counters}"


CHECKS: Final[tuple[Callable[[Link, Link], None], ...]] = (
    packets_arrive_whole_and_in_order,
    long_packets_arrive,
    nobody_hears_itself,
    looking_does_not_wait_and_waiting_ends,
    a_flood_never_blocks_and_every_packet_is_accounted_for,
    hostile_bytes_do_no_harm,
    a_closed_end_drops_and_counts,
    counters_count,
)
"""The contract, one function of (rig, controller) for each clause."""


def check_link(open_pair: Callable[[], Pair]) -> list[str]:
    """Run every check of the contract, each on a fresh pair.

    Args:
        open_pair: opens the rig's and the controller's end, as ``lambda: (open_link(uri, "rig"), open_link(uri,
            "controller"))`` does.

    Returns:
        What the link fulfils and what that earns, a sentence each.

    Raises:
        AssertionError: names the link and the clause that it breaks.

    >>> from transport import memory_pair
    >>> check_link(memory_pair)[0]
    'MemoryLink is a Link: sessions in real time can run over it'
    """
    for check in CHECKS:
        check_clause(check, open_pair)
    rig, controller = open_pair()
    with rig, controller:
        name = type(rig).__name__
        said = [f"{name} is a Link: sessions in real time can run over it"]
        if isinstance(rig, Discoverable):
            said.append(f"{name} Discoverable: `hil discover` can ask it what runs")
    return said


def check_clause(check: Callable[[Link, Link], None], open_pair: Callable[[], Pair]) -> None:
    """Run one check on a fresh pair, once its ends receive from each other."""
    rig, controller = open_pair()
    for end in (rig, controller):
        check_is_link(end)
    with rig, controller:
        meet(rig, controller)
        try:
            check(rig, controller)
        except AssertionError as error:
            raise AssertionError(f"{check.__name__.replace('_', ' ')}: {error}") from error
        except Exception as error:  # a link never raises
            last = extract_tb(error.__traceback__)[-1]
            fault = f"{type(error).__name__}: {error} ({last.filename}, line {last.lineno})"
            raise AssertionError(f"{check.__name__.replace('_', ' ')}: {fault}") from error
