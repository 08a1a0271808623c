"""Packets, the links that carry them, and the network laws that delay and lose them.

Importing the package costs nothing but the packet codec: python-can and zenoh are imported by the link that needs them,
numpy by the network laws.
"""

from pathlib import Path

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
    "dbc_path",
    "decode",
    "encode_control",
    "encode_sensor",
    "memory_pair",
    "open_link",
]


def dbc_path() -> Path:
    """Return the DBC file that names every signal of every frame, for `cantools` and other CAN tools.

    >>> dbc_path().name
    'hilrig.dbc'
    """
    return Path(__file__).with_name("hilrig.dbc")
