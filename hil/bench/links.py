"""Round trips of all links side by side, between two real processes each, with C over UDP as the floor.

Beside ours the plainest links there are: bare Unix sockets, and zenoh with the threads that it starts.

Every link has its own pair of processes, set up as `dc-motor-1khz` sets up rig and controller (priority, locked memory, CPUs
kept awake). The pairs take turns, half a second each, so that what else the machine does hits all of them alike.
"""

from __future__ import annotations

import math
import os
import shutil
import socket
import struct
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, Final, cast

from hil.bench import Ask, Commands, open_pair, part_of_pair
from hil.experiment.tables import Affinity, Timing
from hil.runtime.clock import RealClock, monotonic_ns
from hil.runtime.real import cpu_for, go_real_time
from hil.runtime.real.child import python_module
from transport import ControlPacket, Link, Role, SensorPacket, TransportError, encode_control, encode_sensor, open_link
from transport.links import Closing, LinkCounters
from transport.links.traits import LinkTraits, address_of, scheme_of, traits_of, without_options
from transport.links.zenoh_link import config

if TYPE_CHECKING:
    import zenoh

UNIX: Final = "plain-unix"
"""Scheme of its URIs, ``plain-unix:<path>``, which the benchmark alone knows."""

_PATIENCE: Final = struct.pack("ll", 0, 50_000)  # seconds and microseconds that a receive waits, whatever it is asked


class PlainSocket(Closing):
    """One end of two bare sockets: one system call sends a packet, one receives it. Nothing is checked, no process kept out.

    The controller is there first, and learns from the first packet where the rig is.
    """

    def __init__(self, uri: str, role: Role) -> None:
        self.uri, self.counters = uri, LinkCounters()
        path = address_of(uri)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(f"{path}.{role}")
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, _PATIENCE)
        self._known = role == "rig"
        if self._known:
            self._socket.connect(f"{path}.controller")

    def send(self, packet: bytes) -> None:
        """Send one packet."""
        self._socket.send(packet)

    def receive(self, timeout_s: float) -> bytes | None:
        """Return the next packet, None when none came; 0 s only looks, any other number waits for 50 ms."""
        try:
            if self._known:
                return self._socket.recv(256, 0 if timeout_s > 0 else socket.MSG_DONTWAIT)
            packet, rig = self._socket.recvfrom(256)
        except BlockingIOError:
            return None
        self._socket.connect(rig)
        self._known = True
        return packet

    def close(self) -> None:
        """Let go of it; may be called twice."""
        self._socket.close()


ZENOH: Final = "plain-zenoh"
"""Scheme of its URIs, ``plain-zenoh:<endpoint>``, which the benchmark alone knows."""


class PlainZenoh(Closing):
    """One end of a callback into a queue: no queue limit, no authentication. The rig listens, the controller connects."""

    def __init__(self, uri: str, role: Role) -> None:
        import zenoh

        self.uri, self.counters = uri, LinkCounters()
        self._queue: SimpleQueue[bytes] = SimpleQueue()
        self._session = zenoh.open(config(role, address_of(uri), {}))
        sends, receives = ("sensor", "control") if role == "rig" else ("control", "sensor")
        publisher = self._session.declare_publisher(
            f"hil/plain/{sends}", express=True, priority=zenoh.Priority.REAL_TIME, congestion_control=zenoh.CongestionControl.DROP
        )
        self._put = publisher.put
        self._session.declare_subscriber(f"hil/plain/{receives}", zenoh.handlers.Callback(self._take, indirect=False))

    def _take(self, sample: zenoh.Sample) -> None:
        self._queue.put(sample.payload.to_bytes())

    def send(self, packet: bytes) -> None:
        """Send one packet."""
        self._put(packet)
        self.counters.sent += 1

    def receive(self, timeout_s: float) -> bytes | None:
        """Return the next packet, None when none came in time."""
        try:
            packet = self._queue.get(timeout_s > 0, timeout_s if timeout_s > 0 else None)
        except Empty:
            return None
        self.counters.received += 1
        return packet

    def close(self) -> None:
        """Let go of it; may be called twice."""
        self._session.close()  # type: ignore[no-untyped-call]


LINKS: Final = (
    "can:hil:bench-{pid}",
    UNIX + ":{folder}/bare",
    "can:udp_multicast:239.74.163.2?port={port}",
    "zenoh:tcp/127.0.0.1:{port}",
    "zenoh:unixsock-stream/{folder}/bench",
    ZENOH + ":unixsock-stream/{folder}/plain",
)
"""What is measured by default; bare sockets, python-can's own interface and the plainest use of zenoh beside ours."""

_PEERS: Final[dict[str, Callable[[str, Role], Link]]] = {UNIX: PlainSocket, ZENOH: PlainZenoh}

_PINNED: Final = LinkTraits(commanders="")  # where both ends run is said by the benchmark, not by their link

FLOOR: Final = "C over UDP"
PRIORITY: Final = 60
SLICE_S: Final = 0.5
PATIENCE_NS: Final = 50_000_000  # then a round trip is lost
MEETING_NS: Final = 10_000_000_000

AFFINITIES: Final[tuple[Affinity, ...]] = ("free", "shared")

Row = dict[str, Any]
Way = tuple[str, Affinity]
"""A link, and on which CPUs its two processes run."""


def bench_links(
    rate_hz: float = 1000.0, duration_s: float = 10.0, *, links: Sequence[str] = LINKS, floor: bool = True
) -> list[Row]:  # fmt: skip
    """Measure round trips, 20 bytes there and 48 back, over every link and over plain UDP in C, all in one run.

    Over our link over zenoh twice: with both processes where the scheduler puts them, and on one CPU (`timing.affinity`).

    Args:
        rate_hz: round trips per second.
        duration_s: length for each link, s.
        links: URIs; ``{port}``, ``{pid}`` and ``{folder}`` are filled in.
        floor: whether UDP in C is measured, too.

    Returns:
        One row per link and affinity, the floor first: `link`, `affinity`, `p50_us`, `p99_us`, `p99_9_us`, `times_floor` (ratio
        of the p50), `trips`, `lost`, `late` (lost, or later than the deadline of a session at this rate), `late_share` and
        `note`, which says what was missing where there are no numbers.
    """
    number = max(round(SLICE_S * rate_hz), 1)
    slices = max(round(duration_s * rate_hz / number), 1)
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="hil-bench-")))
        pairs: list[tuple[Way, Ask | str]] = []
        if floor:
            pairs.append(((FLOOR, "free"), open_pair(stack, lambda: _floor(folder, rate_hz))))
        for template in links:
            for how in AFFINITIES if _has_threads(template) else AFFINITIES[:1]:
                (folder / how).mkdir(exist_ok=True)
                uri = template.format(port=free_port(), pid=os.getpid(), folder=folder / how)
                way = without_options(template).format(port="*", pid="*", folder="*"), how
                pairs.append((way, open_pair(stack, _python(uri, how, rate_hz))))
        taken: dict[Way, list[int]] = {way: [] for way, _ in pairs}
        for turn in range(slices + 1):
            for i, (way, ask) in enumerate(pairs):
                if isinstance(ask, str):
                    continue
                try:
                    trips = ask(f"{number}")
                    if len(trips) != number:
                        raise OSError("the driving process ended")
                except (OSError, ValueError) as error:
                    pairs[i] = (way, f"ended in mid-run: {error}")
                    continue
                if turn:  # the first turn warms up
                    taken[way] += trips
    lowest = _percentile(taken.get((FLOOR, "free"), []), 0.5)
    late_ns = Timing().deadline * 1e9 / rate_hz
    return [_row(way, taken[way], lowest, late_ns, pair if isinstance(pair, str) else "") for way, pair in pairs]


def _row(way: Way, taken: list[int], floor_us: float, late_ns: float, note: str) -> Row:
    p50, p99, p99_9 = (_percentile(taken, q) for q in (0.5, 0.99, 0.999))
    lost = sum(trip < 0 for trip in taken)
    late = sum(not 0 <= trip <= late_ns for trip in taken)
    return {
        "link": way[0], "affinity": way[1], "p50_us": p50, "p99_us": p99, "p99_9_us": p99_9, "times_floor": p50 / floor_us,
        "trips": len(taken), "lost": lost, "late": late, "late_share": late / len(taken) if taken else math.nan, "note": note,
    }  # fmt: skip


def _percentile(taken: list[int], q: float) -> float:
    """Return the q-quantile in us of the round trips that came back, NaN if none did.

    >>> _percentile([-1, 3000, 1000, 2000], 0.5)
    2.0
    """
    trips = sorted(trip for trip in taken if trip >= 0)
    return trips[min(int(len(trips) * q), len(trips) - 1)] / 1e3 if trips else math.nan


def _python(uri: str, affinity: Affinity, rate_hz: float) -> Callable[[], Commands]:
    command = python_module("hil.bench.links")
    return lambda: ([*command, "echo", uri, affinity], [*command, "drive", uri, affinity, str(rate_hz)])


def _floor(folder: Path, rate_hz: float) -> Commands:
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        raise OSError("no C compiler is installed, so the floor cannot be measured: apt-get install gcc")
    program = folder / "udp_echo"
    source = Path(__file__).with_name("udp_echo.c")
    subprocess.run([compiler, "-O2", "-o", program, source], check=True, capture_output=True)
    port, any_cpu = str(free_port()), "-1"  # as sessions run: the scheduler chooses the CPU
    echo = [str(program), "echo", port, str(PRIORITY - 1), any_cpu]
    return echo, [str(program), "drive", port, str(PRIORITY), any_cpu, str(rate_hz)]


def _has_threads(template: str) -> bool:
    """Return whether packets of a link of ours pass through threads of its own, which may share a CPU with its ends."""
    try:
        return scheme_of(template) not in _PEERS and traits_of(template.format(port=1, pid=0, folder="")).own_threads
    except TransportError:
        return False  # opening it says so


def free_port() -> int:
    """Return a port of this machine that is free over TCP and over UDP."""
    while True:
        with socket.socket() as over_tcp, socket.socket(type=socket.SOCK_DGRAM) as over_udp:
            over_tcp.bind(("127.0.0.1", 0))
            with suppress(OSError):
                over_udp.bind(over_tcp.getsockname())
                return int(over_tcp.getsockname()[1])


# What follows runs in the processes of a pair.


def _end(uri: str, role: Role) -> Link:
    return _PEERS.get(scheme_of(uri), open_link)(uri, role)


def echo(uri: str, affinity: Affinity) -> None:
    """Answer every packet with a control packet of the same sequence number (its lowest byte), until killed."""
    answers = [encode_control(ControlPacket(seq, 0, 0, 0, 1, ((1.0, 2.0), (3.0, 4.0)))) for seq in range(256)]
    go_real_time(PRIORITY - 1, cpu_for(affinity, "controller", _PINNED), awake=True)
    with _end(uri, "controller") as link:
        print("ready", flush=True)  # noqa: T201 (this is the process's interface)
        while True:
            packet = link.receive(1.0)
            if packet is not None:
                link.send(answers[packet[4]])


def drive(uri: str, affinity: Affinity, rate_hz: float) -> None:
    """Make as many round trips as each line of standard input says, and print how long each took, ns."""
    questions = [encode_sensor(SensorPacket(seq, 0, 0, (1.0,))) for seq in range(256)]
    # Before the link is opened, as in a session: its threads inherit priority and CPU.
    go_real_time(PRIORITY, cpu_for(affinity, "rig", _PINNED), awake=True)
    with _end(uri, "rig") as link:
        limit = monotonic_ns() + MEETING_NS
        while _trip(link, questions, 0) < 0:
            if monotonic_ns() > limit:
                raise TransportError(f"link {uri!r}: no answer within {MEETING_NS / 1e9:g} s")
        print("ready", flush=True)  # noqa: T201
        for line in sys.stdin:
            while link.receive(0) is not None:
                pass
            clock = RealClock(monotonic_ns() + 1_000_000)
            taken = []
            for k in range(int(line)):
                clock.wait_until(round(k * 1e9 / rate_hz))
                taken.append(_trip(link, questions, k + 1))
            print(*taken, flush=True)  # noqa: T201


def _trip(link: Link, questions: list[bytes], seq: int) -> int:
    """Return the ns of one round trip, -1 if the answer did not come in time."""
    seq &= 0xFF
    begin = monotonic_ns()
    link.send(questions[seq])
    while (left := begin + PATIENCE_NS - monotonic_ns()) > 0:
        packet = link.receive(left / 1e9)
        if packet is not None and packet[4] == seq:
            return monotonic_ns() - begin
    return -1


def main() -> None:
    """Be one of the processes of a pair."""
    with part_of_pair(TransportError):
        if sys.argv[1] == "echo":
            echo(sys.argv[2], cast(Affinity, sys.argv[3]))
        else:
            drive(sys.argv[2], cast(Affinity, sys.argv[3]), float(sys.argv[4]))


if __name__ == "__main__":
    main()
