"""What a code in every frame costs, in microseconds and bytes, beside the same packets without one."""

from __future__ import annotations

import os
import statistics
from collections.abc import Callable
from typing import Any

from hil.runtime.clock import monotonic_ns
from transport import ControlPacket, Link, SensorPacket, encode_control, encode_sensor, memory_pair
from transport.links.authentication import AuthenticatedLink, cmac
from transport.packets import EMPTY
from transport.wire import HELLO, with_tag

Row = dict[str, Any]
PACKETS: dict[str, Callable[[int], bytes]] = {
    "question, 1 output": lambda k: encode_sensor(SensorPacket(k, 0, k, (1.0,), reference=(3.0,), nonce=k, counter=k)),
    "answer, 2 rows": lambda k: encode_control(ControlPacket(k, k, k, 0, 1, ((1.0,), (2.0,)), echo=k, counter=k)),
    "answer, 16 rows of 4": lambda k: encode_control(ControlPacket(k, k, k, 0, 4, ((1.0,) * 4,) * 16, echo=k, counter=k)),
}


def bench_auth(progress: Callable[[str], None] = lambda text: None, *, number: int = 2000, turns: int = 10) -> list[Row]:
    """Send packets through memory with a code and without, alternately, and compare.

    Args:
        progress: called with the name of each packet.
        number: packets in one turn.
        turns: how often both ways take their turn.

    Returns:
        One row per packet: `packet`, `bytes` and `bytes_keyed` on the wire, `plain_us` and `keyed_us` (median over the turns of
        one packet sent and received), `code_us` their difference: the code is computed twice, once at each end.
    """
    rows = []
    for name, make in PACKETS.items():
        progress(name)
        packets = [make(k) for k in range(1, number + 1)]
        taken: dict[str, list[float]] = {"plain": [], "keyed": []}
        for _ in range(turns):
            for way in taken:
                rig, controller = _pair(way == "keyed")
                ends = (controller, rig) if name.startswith("answer") else (rig, controller)
                taken[way].append(_trip_us(*ends, packets))
        plain, keyed = (statistics.median(taken[way]) for way in ("plain", "keyed"))
        sealed = with_tag(packets[0], lambda signed: bytes(8)) or b""
        rows.append({
            "packet": name, "bytes": len(packets[0]), "bytes_keyed": len(sealed), "plain_us": plain, "keyed_us": keyed,
            "code_us": keyed - plain,
        })  # fmt: skip
    return rows


def _pair(keyed: bool) -> tuple[Link, Link]:
    rig, controller = memory_pair()
    if not keyed:
        return rig, controller
    code = cmac(os.urandom(16))
    first, second = AuthenticatedLink(rig, "rig", code), AuthenticatedLink(controller, "controller", code)
    first.send(encode_sensor(SensorPacket(HELLO, EMPTY, 0, (), nonce=1, counter=1)))
    second.receive(0)
    return first, second


def _trip_us(sender: Link, receiver: Link, packets: list[bytes]) -> float:
    begin = monotonic_ns()
    for packet in packets:
        sender.send(packet)
        if receiver.receive(0) is None:
            raise RuntimeError("a packet was lost in memory")
    return (monotonic_ns() - begin) / 1e3 / len(packets)
