"""Packets in files of other programs: latencies in a table (.csv), round trips of ping and frames of hil in a capture (.pcap).

Reference: libpcap's file format (pcap-savefile), RFC 792, RFC 4443. Of the readers on PyPI none is both small and kept.
"""

from __future__ import annotations

import struct
from collections.abc import Hashable, Iterable, Iterator
from itertools import count, islice
from pathlib import Path
from typing import BinaryIO, Final, NamedTuple

import numpy as np

from hil.errors import HilError
from hil.files import open_regular
from hil.files.arrays import read_columns
from hil.files.can_logs import LATEST_S, can_frames
from hil.log.recordings import ROUND_TRIP, THERE, Array, Recording, Way
from transport.packets import ControlPacket, SensorPacket, decode, packet_size

TCP, UDP = 6, 17
HEAD = 128
"""Bytes that tell the length of a frame, at most."""


def read_captured_frames(path: Path) -> Recording | None:
    """Read frames of hil from a capture (.pcap); None of one that holds none.

    Raises:
        HilError: it is no capture, or holds sensor frames and no answer: a capture of one direction.
    """
    with open_regular(path, "a capture") as file:
        found = _paired((
            (t_s, (frame.seq, frame.sample_ns), not isinstance(frame, ControlPacket))
            for t_s, packet in captured_packets(path, file) for frame in _frames(_segment(packet))
        ), newest=False)  # fmt: skip
    if not len(found.sent_s) and not found.strays:
        return None
    if not np.isfinite(found.came_s).any():
        what = "sensor frames, and no answer" if len(found.sent_s) else "control frames, and no sensor frame that they answer"
        raise HilError(f"{path}: {what}: a capture of one direction; expected both, as tcpdump takes them at one end")
    return found.recording(path, "round trips of our own frames, from where they were captured")


class _Pairs(NamedTuple):
    """Questions of a capture and their answers.

    Attributes:
        sent_s: when each was asked.
        came_s: when its first answer came, NaN where none did.
        again: answers to what was answered already.
        strays: answers to no question.
    """

    sent_s: Array
    came_s: Array
    again: int
    strays: int

    def recording(self, path: Path, *notes: str) -> Recording:
        """Return them as round trips."""
        way = Way(sent_s=self.sent_s, difference_s=self.came_s - self.sent_s)
        return Recording(source=str(path), ways={ROUND_TRIP: way}, clocks=1, notes=notes)


def _paired(packets: Iterable[tuple[float, Hashable, bool]], *, newest: bool) -> _Pairs:
    """Return which question each answer belongs to.

    Args:
        packets: instant, key that question and answer share, and whether it is a question.
        newest: a key that is asked again is another question, the one that is answered; else it is the same one.
    """
    asked: dict[Hashable, int] = {}
    sent: list[float] = []
    came: list[float] = []
    again = strays = 0
    for t_s, key, asks in packets:
        if asks and (newest or key not in asked):
            asked[key] = len(sent)
            sent.append(t_s)
            came.append(np.nan)
        elif not asks and key not in asked:
            strays += 1
        elif not asks and np.isnan(came[asked[key]]):
            came[asked[key]] = t_s
        else:
            again += not asks
    return _Pairs(np.array(sent), np.array(came), again, strays)


def _ip_head(packet: bytes) -> tuple[int, int, int, bytes, bytes] | None:
    """Where what an IP packet carries begins and ends, its protocol and its two addresses; None for other packets."""
    if len(packet) >= 20 and packet[0] >> 4 == 4:
        return 4 * (packet[0] & 15), int.from_bytes(packet[2:4], "big"), packet[9], packet[12:16], packet[16:20]
    if len(packet) >= 40 and packet[0] >> 4 == 6:
        return 40, 40 + int.from_bytes(packet[4:6], "big"), packet[6], packet[8:24], packet[24:40]
    return None


def _segment(packet: bytes) -> bytes:
    """What a TCP or UDP segment of an IP packet carries; nothing of other packets."""
    head = _ip_head(packet)
    if head is None:
        return b""
    at, end, protocol, *_ = head
    if protocol == UDP:
        return packet[at + 8 : end]
    return packet[at + 4 * (packet[at + 12] >> 4) : end] if protocol == TCP and len(packet) > at + 12 else b""


def _frames(data: bytes) -> Iterator[SensorPacket | ControlPacket]:
    at = 0
    while at + 4 <= len(data):
        size = packet_size(data[at : at + HEAD])
        frame = decode(data[at : at + size]) if size and at + size <= len(data) else None
        if frame is not None and size:
            yield frame
        at += size if frame is not None and size else 1


VALUES = {"latency_s": (THERE, 1.0), "latency_ms": (THERE, 1e-3), "rtt_s": (ROUND_TRIP, 1.0), "rtt_ms": (ROUND_TRIP, 1e-3)}
NOMINAL_S = 1.0
"""Time between packets of a table that does not say when they were sent."""


def read_latencies(path: Path, *, one_clock: bool) -> Recording:
    """Read a table of packets (.csv): latencies, round trips, or the time stamps of both ends.

    | columns | what they are |
    |---|---|
    | `latency_s` or `latency_ms` | one direction; with `sent_s` beside it where there is one |
    | `rtt_s` or `rtt_ms` | round trips; likewise |
    | `sent_s`, `received_s` | instants at the clocks of both ends |

    A packet that was lost has an empty entry, `lost` or `nan`. Without `sent_s` the file has one line for every packet, in order.

    Args:
        path: the file.
        one_clock: `sent_s` and `received_s` are of one clock.

    Raises:
        HilError: names the file, the line and what was expected.
    """
    known = (*VALUES, "sent_s", "received_s")
    header, table, lines, _ = read_columns(path, "a table of packets", lambda header: [name for name in header if name in known])
    columns = {name: table[:, i] for i, name in enumerate(name for name in header if name in known)}
    if len(late := np.argwhere(np.abs(table) >= LATEST_S)):
        raise HilError(f"{path}:{lines[late[0, 0]]}: {table[tuple(late[0])]:.9g}, expected a number below {LATEST_S:g}")
    value = next((name for name in VALUES if name in columns), None)
    sent = columns.get("sent_s")
    if sent is not None and np.isnan(sent).any():
        raise HilError(f"{path}:{lines[int(np.isnan(sent).argmax())]}: sent_s: missing, expected the instant of every packet")
    if sent is not None and len(back := np.flatnonzero(np.diff(sent) < 0.0)):
        at = int(back[0]) + 1
        raise HilError(f"{path}:{lines[at]}: sent_s: {sent[at]:.9g} follows {sent[at - 1]:.9g}: time stamps run backwards")
    if value is not None:
        name, unit = VALUES[value]
        found = columns[value] * unit
        wrong = np.flatnonzero(found < 0.0)
        if len(wrong):
            at = int(wrong[0])
            raise HilError(f"{path}:{lines[at]}: {value}: {columns[value][at]:.9g} is negative, expected a latency >= 0")
        slot = f"one a slot (of {NOMINAL_S:g} s without --period)"
        notes = () if sent is not None else (f"{path}: no column sent_s: the lines are taken as packets in order, {slot}",)
        instants = sent if sent is not None else np.arange(len(found), dtype=np.float64) * NOMINAL_S
        way = Way(sent_s=instants, difference_s=found)
        return Recording(source=str(path), ways={name: way}, clocks=0 if sent is None else 1, notes=notes)
    if sent is None or "received_s" not in columns:
        wanted = f"{', '.join(VALUES)}, or sent_s and received_s"
        raise HilError(f"{path}: the first line names no column of latencies: {', '.join(header)[:200]!r}; expected {wanted}")
    way = Way(sent_s=sent, difference_s=columns["received_s"] - sent)
    wrong = np.flatnonzero(way.difference_s < 0.0)
    if one_clock and len(wrong):
        at = int(wrong[0])
        raise HilError(
            f"{path}:{lines[at]}: received_s lies {-way.difference_s[at]:.6g} s before sent_s, of one clock (--one-clock)"
        )
    return Recording(source=str(path), ways={THERE: way}, clocks=1 if one_clock else 2)


LONGEST: Final = 1 << 18
MOST_FRAMES: Final = 5_000_000
"""Packets of a capture, or frames of a CAN log, at most."""
MAGIC: Final = {b"\xa1\xb2\xc3\xd4": (">", 1e-6), b"\xd4\xc3\xb2\xa1": ("<", 1e-6),
                b"\xa1\xb2\x3c\x4d": (">", 1e-9), b"\x4d\x3c\xb2\xa1": ("<", 1e-9)}  # fmt: skip
IP_AT: Final = {1: 14, 12: 0, 14: 0, 101: 0, 113: 16, 228: 0, 229: 0, 276: 20, 0: 4, 108: 4}
"""Where the IP packet begins, by link type: Ethernet, raw IP, Linux "cooked" 1 and 2, BSD loopback."""

ECHO: Final = {(4, 1, 8): True, (4, 1, 0): False, (16, 58, 128): True, (16, 58, 129): False}
"""Length of an address, protocol and type of ping's packets: whether it is a request."""


def read_can_requests(path: Path, can_id: int, answer_id: int) -> Recording:
    """Read round trips from one CAN log: frames of one identifier, and those of another that answer them.

    Raises:
        HilError: it is no CAN log, one of the two is missing, or there are too many frames.
    """
    asks = [(frame.timestamp, frame.arbitration_id == can_id) for frame in islice(
        (frame for frame in can_frames(path) if not frame.is_error_frame and frame.arbitration_id in (can_id, answer_id)),
        MOST_FRAMES + 1)]  # fmt: skip
    if len(asks) > MOST_FRAMES:
        raise HilError(f"{path}: more than {MOST_FRAMES} frames of these identifiers")
    found = _paired(((t_s, None, asked) for t_s, asked in asks), newest=True)
    for identifier, some in ((can_id, len(found.sent_s)), (answer_id, np.isfinite(found.came_s).any())):
        if not some:
            what = "no frame of identifier" if identifier == can_id else "no frame behind one of --can-id has the identifier"
            raise HilError(f"{path}: {what} {identifier:#x}; what a log writes as 123 is 0x123")
    odd = (found.again, "answers came behind the first"), (found.strays, "answers to no request")
    rule = "an answer is that to the newest request: one that comes behind the next request counts as an answer to that"
    return found.recording(path, rule, *(f"{n} {what}" for n, what in odd if n))


def read_ping_capture(path: Path) -> Recording:
    """Read round trips of ping from a capture (.pcap).

    They are ICMP echo requests and replies, IPv4 and IPv6, paired by identifier and number.

    Raises:
        HilError: it is none, or holds no echo requests, or no reply: a capture of one direction.
    """
    with open_regular(path, "a capture") as file:
        found = _paired(_echoes(path, file), newest=True)  # numbers wrap after 65536
    if not np.isfinite(found.came_s).any():
        what = "echo requests, and no reply" if len(found.sent_s) else "no echo request"
        raise HilError(
            f"{path}: {what}: a capture of one direction; expected both, as `tcpdump -w ping.pcap icmp or icmp6` takes them"
        )
    odd = (found.again, "replies came twice: the first counts"), (found.strays, "replies to no request")
    return found.recording(path, *(f"{n} {what}" for n, what in odd if n))


def _echoes(path: Path, file: BinaryIO) -> Iterator[tuple[float, Hashable, bool]]:
    for t_s, packet in captured_packets(path, file):
        if (head := _ip_head(packet)) is None or len(packet) < head[0] + 8:
            continue
        at, _, protocol, *ends = head
        asks = ECHO.get((len(ends[0]), protocol, packet[at]))
        if asks is not None:
            yield t_s, (*sorted(ends), *struct.unpack_from(">HH", packet, at + 4)), asks


def captured_packets(path: Path, file: BinaryIO) -> Iterator[tuple[float, bytes]]:
    """IP packets with their instants, counted from the first."""
    head = file.read(24)
    if head[:4] == b"\n\r\r\n":
        raise HilError(f"{path}: is a pcapng capture; expected pcap: editcap -F pcap {path.name} ping.pcap")
    if len(head) < 24 or head[:4] not in MAGIC:
        raise HilError(f"{path}: is no pcap capture")
    order, unit = MAGIC[head[:4]]
    link = struct.unpack(order + "I", head[20:24])[0] & 0xFFFF
    if link not in IP_AT:
        raise HilError(f"{path}: link type {link}, expected one of {', '.join(map(str, sorted(IP_AT)))}")
    record, first = struct.Struct(order + "IIII"), None
    for number in count():
        if len(begin := file.read(record.size)) < record.size:
            return
        if number == MOST_FRAMES:
            raise HilError(f"{path}: more than {MOST_FRAMES} packets; divide it: editcap -c {MOST_FRAMES} {path.name} part.pcap")
        seconds, fraction, length, _ = record.unpack(begin)
        if length > LONGEST:
            raise HilError(f"{path}: a packet of {length} bytes at byte {file.tell() - record.size}, at most {LONGEST}")
        data = file.read(length)
        if len(data) < length:
            return  # the capture was ended in the midst of a packet
        first = seconds if first is None else first
        yield (seconds - first) + fraction * unit, data[IP_AT[link] :]
