"""An intruder on the rig's link, which answers in the controller's place: -4 V, whatever the reference is.

Usage: intruder.py URI (ahead | race | fill | role)

*ahead*: upon question k it answers the eight slots after it, with the time stamp 0 and the digest of question k.
*race*: it answers question k at once, digest and all. *fill*: as ahead, 300 times over, so that the rig's queue is full.
*role*: a controller of ours that answers nothing.
"""

import os
import sys
from contextlib import suppress
from queue import SimpleQueue
from tempfile import mkdtemp

import can
import zenoh

from transport import ControlPacket, SensorPacket, TransportError, decode, encode_control, open_link
from transport.links.can_bus import HilBus
from transport.links.can_datagram import FDF, FRAME
from transport.links.zenoh_link import config
from transport.wire import echo

U = -4.0


def answer(packet: SensorPacket, seq: int, data: bytes) -> bytes:
    rows = ((U,), (U,))
    return encode_control(ControlPacket(seq, packet.sample_ns, 0, 0, 1, rows, echo([data])))


def answers(packet: SensorPacket, data: bytes, way: str) -> list[bytes]:
    if packet.seq == 0xFFFFFFFF:
        return []
    if way == "race":
        return [answer(packet, packet.seq, data)]
    return [answer(packet, packet.seq + ahead, data) for ahead in range(1, 9)] * (40 if way == "fill" else 1)


def on_can(channel: str, way: str) -> None:
    with HilBus(channel, can_filters=[{"can_id": 0x100, "can_mask": 0x7C0, "extended": False}]) as bus:
        print("up", flush=True)
        while True:
            frame = bus.frames.recv_frame(1.0)
            packet = decode(frame[2]) if frame is not None else None
            if isinstance(packet, SensorPacket):
                for data in answers(packet, frame[2], way):
                    with suppress(can.CanError, OSError):
                        bus.frames.mesh.send(FRAME.pack(0.0, 0, 0x140, len(data), FDF) + data)


def on_zenoh(uri: str, way: str) -> None:
    received: SimpleQueue[bytes] = SimpleQueue()
    with zenoh.open(config("controller", uri.removeprefix("zenoh:"), {})) as session:  # no token says that it is one of ours
        put = session.declare_publisher("hil/rig0/control", congestion_control=zenoh.CongestionControl.DROP).put
        took = zenoh.handlers.Callback(lambda sample: received.put(sample.payload.to_bytes()), indirect=False)
        session.declare_subscriber("hil/rig0/sensor", took)
        print("up", flush=True)
        while True:
            data = received.get()
            packet = decode(data)
            if isinstance(packet, SensorPacket):
                for each in answers(packet, data, way):
                    put(each)


def as_one_of_ours(uri: str) -> None:
    """Hold the role, and answer nothing; look for a rig so often that one is found as soon as it is there."""
    print("up", flush=True)
    while True:
        with suppress(TransportError), open_link(uri, "controller") as link:
            while link.receive(0.2) is not None:
                pass


def main() -> None:
    uri, way = sys.argv[1:]
    os.environ["HIL_CLAIM_DIR"] = mkdtemp()  # an intruder claims no role
    if way == "role":
        as_one_of_ours(uri)
    elif uri.startswith("can:hil:"):
        on_can(uri.rpartition(":")[2], way)
    else:
        on_zenoh(uri, way)


if __name__ == "__main__":
    main()
