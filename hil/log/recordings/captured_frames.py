"""Round trips of our own frames in a capture (.pcap): sensor frames, and control frames that answer them, as zenoh carries them.

`tcpdump -i eth0 -w link.pcap tcp port 7447` beside a running `hil probe zenoh:...`, or beside a run in real time, sees each frame
within a TCP or UDP segment. An answer repeats number and instant of its sample. A frame that two segments share is not seen.

Reference: RFC 791, RFC 8200, RFC 9293, RFC 768; our frames: `hil guide wire-format`.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from hil.errors import HilError
from hil.files.regular import open_regular
from hil.log.recordings.foreign_packets import captured_packets
from hil.log.recordings.recording import ROUND_TRIP, Recording, Way
from transport.packets import ControlPacket, SensorPacket, decode, packet_size

TCP, UDP = 6, 17
HEAD = 128
"""Bytes that tell the length of a frame, at most."""


def read_captured_frames(path: Path) -> Recording | None:
    """Read a capture; None of one that holds none of our frames.

    Raises:
        HilError: it is no capture, or holds sensor frames and no answer: a capture of one direction.
    """
    asked: dict[tuple[int, int], int] = {}
    sent: list[float] = []
    came: list[float] = []
    answers = 0
    with open_regular(path, "a capture") as file:
        for t_s, packet in captured_packets(path, file):
            for frame in _frames(_segment(packet)):
                key = frame.seq, frame.sample_ns
                if isinstance(frame, ControlPacket):
                    answers += 1
                    if key in asked and np.isnan(came[asked[key]]):
                        came[asked[key]] = t_s
                elif key not in asked:
                    asked[key] = len(sent)
                    sent.append(t_s)
                    came.append(np.nan)
    if not sent and not answers:
        return None
    if not np.isfinite(came).any():
        what = "sensor frames, and no answer" if sent else "control frames, and no sensor frame that they answer"
        raise HilError(f"{path}: {what}: a capture of one direction; expected both, as tcpdump takes them at one end")
    instants = np.array(sent)
    return Recording(
        source=str(path), ways={ROUND_TRIP: Way(sent_s=instants, difference_s=np.array(came) - instants)}, clocks=1,
        notes=("round trips of our own frames, from where they were captured",),
    )  # fmt: skip


def _segment(packet: bytes) -> bytes:
    """What a TCP or UDP segment of an IP packet carries; nothing of other packets."""
    if len(packet) < 20:
        return b""
    if packet[0] >> 4 == 4:
        at, protocol, end = 4 * (packet[0] & 15), packet[9], int.from_bytes(packet[2:4], "big")
    elif packet[0] >> 4 == 6 and len(packet) >= 40:
        at, protocol, end = 40, packet[6], 40 + int.from_bytes(packet[4:6], "big")
    else:
        return b""
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
