"""A flood on the identifiers of the rig or of the controller, from a process at normal priority.

Usage: flooder.py CHANNEL SECONDS KIND (rig | controller); it says "up" once it is on the bus, begins at a line of standard
input, and says "sent" behind its first thousand frames. A channel of can:hil, or an endpoint and a name of zenoh:
``tcp/127.0.0.1:7447 rig0``.
"""

from __future__ import annotations

import os
import sys
import time
from collections import deque
from functools import partial
from itertools import count
from queue import SimpleQueue
from typing import Any, Final

from transport import ControlPacket, SensorPacket, decode, encode_control, encode_sensor
from transport.links.can_bus import HilBus
from transport.wire import tag_of, with_tag

KINDS: Final = ("filtered", "garbage", "forged tags", "half a tag", "own frames, late", "another session", "wrapped numbers")
"""Frames of another identifier; no packets; codes that are none; codes that hold in part; what the rig and its controller said,
again; sound answers of another session to the slot at hand; and numbers at the end of their range."""

NUMBERS: Final = (0, 1, 2**31 - 1, 2**31, 2**32 - 2, 2**32 - 1)
CONTROL, SENSOR = 0x140, 0x100


class Flood:
    """Frames of a kind, one after the other.

    Args:
        kind: one of `KINDS`.
        aim: whom it is for: the rig is given answers, the controller questions.
    """

    def __init__(self, kind: str, aim: str) -> None:
        self._kind, self._number = kind, count()
        self._id, self._says = (CONTROL, answer) if aim == "rig" else (SENSOR, question)
        self._heard: deque[tuple[int, bytes]] = deque(maxlen=64)
        self._slot = 0

    def hear(self, identifier: int, data: bytes) -> None:
        """Keep what was said on the bus."""
        packet = decode(data)
        if packet is not None:
            self._heard.append((identifier, data))
        if isinstance(packet, SensorPacket) and packet.seq != 0xFFFFFFFF:
            self._slot = packet.seq

    def next(self) -> tuple[int, bytes]:
        """Return identifier and bytes of the next frame."""
        i = next(self._number)
        if self._kind == "filtered":
            return 0x300, b"garbage!"
        if self._kind == "own frames, late" and self._heard:
            return self._heard[i % len(self._heard)]
        if self._kind in ("forged tags", "half a tag"):
            code = b"forgery!" if self._kind == "forged tags" else self._half(i)
            data = with_tag(self._says(self._slot if i % 2 else 7, counter=2**31 + i % 2**31), lambda signed: code)
            return self._id, data or b""
        if self._kind == "another session":
            return self._id, self._says(self._slot, counter=i % 2**32, echo=i)
        if self._kind == "wrapped numbers":
            seq, counter = NUMBERS[i % len(NUMBERS)], NUMBERS[i // len(NUMBERS) % len(NUMBERS)]
            return self._id, self._says(seq, counter=counter, sample_ns=2**63 - 1 if i % 3 else -(2**63))
        return self._id, b"garbage!"

    def _half(self, i: int) -> bytes:
        """Return a code of which half comes from a frame of the sender in whose place this is sent."""
        said = next((data for identifier, data in reversed(self._heard) if identifier == self._id), b"")
        found = tag_of(said)
        tag = found.tag if found is not None else b""
        return tag[:4] + i.to_bytes(8, "little")[:4] if len(tag) == 8 else b"forgery!"


def answer(seq: int, *, counter: int, echo: int = 1, sample_ns: int = 0) -> bytes:
    """Return an answer of 4 V to a slot."""
    return encode_control(ControlPacket(seq, sample_ns, 0, 0, 0, ((4.0,),), echo, counter))


def question(seq: int, *, counter: int, echo: int = 1, sample_ns: int = 0) -> bytes:
    """Return a sample of 4 rad in a slot."""
    return encode_sensor(SensorPacket(seq=seq, flags=0, sample_ns=sample_ns, y=(4.0,), nonce=echo, counter=counter))


class ZenohPeer:
    """A foreign program that the rig lets in at its endpoint: it says no session, and claims no role."""

    def __init__(self, endpoint: str, name: str) -> None:
        import zenoh

        from transport.links.zenoh_link import config

        self._heard: SimpleQueue[tuple[int, bytes]] = SimpleQueue()
        self._session = zenoh.open(config("controller", endpoint, {}))
        drop = zenoh.CongestionControl.DROP
        self._put = {
            identifier: self._session.declare_publisher(f"hil/{name}/{key}", express=True, congestion_control=drop).put
            for key, identifier in (("control", CONTROL), ("sensor", SENSOR))
        }
        for key, identifier in (("sensor", SENSOR), ("received", CONTROL)):
            hear = zenoh.handlers.Callback(partial(self._hear, identifier), indirect=False)
            self._session.declare_subscriber(f"hil/{name}/{key}", hear)

    def _hear(self, identifier: int, sample: Any) -> None:
        self._heard.put((identifier, sample.payload.to_bytes()))

    def send_frame(self, identifier: int, data: bytes) -> None:
        self._put.get(identifier, self._put[CONTROL])(data)

    def recv_frame(self, _timeout_s: float) -> tuple[int, bool, bytes] | None:
        if self._heard.empty():
            return None
        identifier, data = self._heard.get()
        return identifier, False, data

    def __enter__(self) -> ZenohPeer:
        return self

    def __exit__(self, *_: object) -> None:
        self._session.close()  # type: ignore[no-untyped-call]


def main() -> None:
    channel, seconds, kind, aim = sys.argv[1:]
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    flood = Flood(kind, aim)
    with ZenohPeer(*channel.split()) if " " in channel else HilBus(channel) as joined:
        bus = joined.frames if isinstance(joined, HilBus) else joined
        print("up", flush=True)
        end = time.monotonic() + float(seconds) if sys.stdin.readline() else 0.0
        while isinstance(bus, ZenohPeer) and time.monotonic() < end:  # zenoh connects when it tries again, in a second or two
            received = bus.recv_frame(0.0)
            if received is not None:
                flood.hear(received[0], received[2])
                break
            time.sleep(0.001)
        for turn in count(1):
            if time.monotonic() >= end:
                break
            for _ in range(100):
                bus.send_frame(*flood.next())  # the rig's queue is full soon; the rest is dropped there
            for _ in range(20):
                received = bus.recv_frame(0.0)
                if received is None:
                    break
                flood.hear(received[0], received[2])
            if turn == 10:
                print("sent", flush=True)


if __name__ == "__main__":
    main()
