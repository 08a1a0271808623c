"""A real link, measured: sensor frames out at a rate, control frames back, each with the clocks of both ends.

The frames are the product's own. The answering end puts its clock into `control_ns`, and a digest of its boot into `echo`: if
that is ours too, and every answer is dated between question and receipt, both ends read one CLOCK_MONOTONIC, and latencies of
one way are what they seem.
"""

from __future__ import annotations

import secrets
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from hashlib import sha256
from pathlib import Path
from shlex import quote
from typing import Final, NamedTuple

from msgspec import Struct

from hil.bench import part_of_pair, running
from hil.errors import HilError, located
from hil.log import Logged
from hil.log.records import Channel, Schema
from hil.log.topics import PROBE
from hil.log.write.mcap_sink import McapSink
from hil.log.write.provenance import Provenance
from hil.runtime.clock import RealClock, monotonic_ns, wall_clock
from hil.runtime.real.child import python_module
from transport import ControlPacket, Link, SensorPacket, TransportError, decode, encode_control, encode_sensor, open_link

LEAD_NS: Final = 5_000_000
MEETING_NS: Final = 5_000_000_000
STRAGGLERS_NS: Final = 1_000_000_000
IDLE_S: Final = 0.2


class Trip(Struct):
    """One round trip, instants of CLOCK_MONOTONIC at both ends, ns; 0 for never."""

    sent_ns: int
    answered_ns: int = 0
    received_ns: int = 0


class Probed(NamedTuple):
    """What came of a probe.

    Args:
        trips: in the order of sending.
        one_clock: whether both ends read one clock.
        answered_again: trips to which another answer came, of another instant: two processes answer on this link. What the link
            itself doubles is of one instant.
    """

    trips: list[Trip]
    one_clock: bool
    answered_again: int


def own_boot() -> int:
    """Return a number that distinguishes this boot of this machine from others, 1 to 2^64 - 1."""
    try:
        said = Path("/proc/sys/kernel/random/boot_id").read_bytes()
    except OSError:
        return secrets.randbits(63) + 1
    return int.from_bytes(sha256(said).digest()[:8], "little") or 1


def answer(link: Link) -> None:
    """Answer every sensor frame at once, until stopped."""
    boot = own_boot()
    while True:
        data = link.receive(IDLE_S)
        packet = None if data is None else decode(data)
        if isinstance(packet, SensorPacket):
            link.send(
                encode_control(ControlPacket(packet.seq, packet.sample_ns, monotonic_ns(), 0, 0, ((0.0,),), boot, packet.counter))
            )


def probe(link: Link, rate_hz: float, seconds: float, progress: Callable[[int, int], object] = lambda done, of: None) -> Probed:
    """Send frames at a rate, and take what comes back; the first answer counts.

    Args:
        link: the rig's end.
        rate_hz: frames per second.
        seconds: for how long.
        progress: given how many were sent, of how many.

    Raises:
        HilError: no answer came within five seconds.
    """
    boot, count, nonce = own_boot(), max(1, round(rate_hz * seconds)), secrets.randbits(63) + 1
    trips = [Trip(0) for _ in range(count)]
    one_clock = True
    again: set[int] = set()

    def send(seq: int, sample_ns: int) -> None:
        link.send(encode_sensor(SensorPacket(seq=seq, flags=0, sample_ns=sample_ns, y=(0.0,), nonce=nonce, counter=seq)))

    def take(until_ns: int) -> bool:
        """Take answers until an instant; return whether one is of a trip or of the greeting."""
        nonlocal one_clock
        met = False
        while (left := until_ns - monotonic_ns()) > 0:
            data = link.receive(left / 1e9)
            now = monotonic_ns()
            packet = None if data is None else decode(data)
            if not isinstance(packet, ControlPacket):
                continue
            if packet.control_ns <= 0:  # no CLOCK_MONOTONIC says so
                continue
            met = True
            one_clock = one_clock and packet.echo == boot and packet.sample_ns <= packet.control_ns <= now
            if packet.seq >= count or not packet.sample_ns == trips[packet.seq].sent_ns > 0:
                continue
            trip = trips[packet.seq]
            if not trip.received_ns:
                trip.answered_ns, trip.received_ns = packet.control_ns, now
            elif packet.control_ns != trip.answered_ns:
                again.add(packet.seq)
        return met

    limit = monotonic_ns() + MEETING_NS
    greeting = count
    while True:
        send(greeting, monotonic_ns())
        if take(monotonic_ns() + 100_000_000):
            break
        if monotonic_ns() > limit:
            remedy = f"run `hil probe {quote(link.uri)} --answer` at its other end"
            raise HilError(f"link {link.uri!r}: no answer within {MEETING_NS / 1e9:g} s; {remedy}")
    take(monotonic_ns() + 100_000_000)
    start = monotonic_ns() + LEAD_NS
    clock = RealClock(start)
    for k, trip in enumerate(trips):
        due = round(k * 1e9 / rate_hz)
        take(start + due - LEAD_NS // 25)
        clock.wait_until(due)
        trip.sent_ns = monotonic_ns()
        send(k, trip.sent_ns)
        progress(k + 1, count)
    end = monotonic_ns() + STRAGGLERS_NS
    while monotonic_ns() < end and not all(trip.received_ns for trip in trips[-100:]):
        take(min(end, monotonic_ns() + 20_000_000))
    return Probed(trips, one_clock, len(again))


def write_probe_log(path: Path, uri: str, rate_hz: float, trips: list[Trip], one_clock: bool) -> None:
    """Write a log of a probed link; instants count from the first frame.

    Args:
        path: a new file.
        uri: of the link.
        rate_hz: frames per second.
        trips: what was measured.
        one_clock: whether both ends read one clock.

    Raises:
        HilError: it cannot be written.
    """
    table = {
        PROBE.name: Channel(
            id=1, topic=PROBE.name, schema=Schema(name=PROBE.schema_name(Logged()), fields=PROBE.fields(Logged()))
        )
    }
    provenance = Provenance(
        experiment="probe", experiment_text="", resolved={}, certificate=None, seed=0, clock="real", link=uri, codes={},
        session={"started": wall_clock(), "clocks": "1" if one_clock else "2", "rate_hz": repr(rate_hz)},
    )  # fmt: skip
    begun = trips[0].sent_ns
    with McapSink(path, table, provenance) as sink:
        put = sink.records((PROBE.name,))
        assert put is not None
        for k, trip in enumerate(trips):
            sent, answered, received = (0 if t == 0 else t - begun for t in (trip.sent_ns, trip.answered_ns, trip.received_ns))
            put(sent, (sent, answered, received, k))
            sink.commit()
    if sink.error is not None:
        raise HilError(f"log {sink.error}; free some space, or write elsewhere (-o)")


@contextmanager
def answering(uri: str) -> Iterator[None]:
    """Answer on a link in a process of its own, for a link within this machine."""
    with ExitStack() as stack:
        with located("the answering process", OSError):
            stack.enter_context(running(python_module("hil.bench.probe", uri)))
        yield


def main() -> None:
    """Be the answering process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with part_of_pair(TransportError), open_link(sys.argv[1], "controller") as link:
        print("ready", flush=True)  # noqa: T201 (this is the process's interface)
        answer(link)


if __name__ == "__main__":
    main()
