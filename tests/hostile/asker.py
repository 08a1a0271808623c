"""Somebody on a `can:hil` bus who asks the controller in the rig's place, and never answers.

Usage: asker.py CHANNEL (more | future | hello | same | beside)
"""

import sys
from contextlib import suppress

import can

from transport import EMPTY, MORE, SensorPacket, decode, encode_sensor
from transport.links.can_bus import HilBus

HELLO, PERIOD_NS, Y = 0xFFFFFFFF, 50_000_000, 10.0


def forged(asked: SensorPacket, way: str) -> list[SensorPacket]:
    """What is sent when the rig has asked."""
    k = asked.seq
    ahead = asked._replace(y=(Y,) * max(len(asked.y), 1), samples=1, counter=asked.counter + 1)
    if way == "more":
        return [ahead._replace(seq=k + i, sample_ns=(k + i) * PERIOD_NS, flags=MORE) for i in (1, 2)]
    if way == "future":
        return [ahead._replace(seq=10**6, sample_ns=10**6 * PERIOD_NS, flags=MORE)]
    if way == "hello":
        return [SensorPacket(HELLO, EMPTY, 0, (), nonce=nonce, counter=1) for nonce in (asked.nonce, 7, 0)]
    if way == "same":
        return [asked._replace(y=(Y,) * len(asked.y))]
    return [ahead._replace(sample_ns=k * PERIOD_NS, flags=MORE), ahead._replace(sample_ns=k * PERIOD_NS, flags=0)]


def main() -> None:
    channel, way = sys.argv[1:]
    with HilBus(channel, can_filters=[{"can_id": 0x100, "can_mask": 0x7C0, "extended": False}]) as bus:
        print("up", flush=True)
        while True:
            frame = bus.frames.recv_frame(1.0)
            asked = decode(frame[2]) if frame is not None else None
            if isinstance(asked, SensorPacket) and asked.seq != HELLO:
                for packet in forged(asked, way):
                    with suppress(can.CanError, OSError, ValueError):
                        bus.frames.send_frame(0x100, encode_sensor(packet))


if __name__ == "__main__":
    main()
