"""Packets, the links that carry them, and the network laws that delay and lose them.

Importing the package costs nothing but the packet codec: python-can and zenoh are imported by the link that needs them,
numpy by the network laws.
"""

from transport.link import Link, LinkCounters, Role, TransportError, open_link
from transport.memory import MemoryLink, memory_pair
from transport.packets import (
    EMPTY,
    MORE,
    SELECTIONS,
    ControlPacket,
    SensorPacket,
    decode,
    encode_control,
    encode_sensor,
)

__all__ = [
    "EMPTY",
    "MORE",
    "SELECTIONS",
    "ControlPacket",
    "Link",
    "LinkCounters",
    "MemoryLink",
    "Role",
    "SensorPacket",
    "TransportError",
    "decode",
    "encode_control",
    "encode_sensor",
    "memory_pair",
    "open_link",
]
