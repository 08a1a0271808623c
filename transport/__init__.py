"""Packets, the links that carry them, and the network laws that delay and lose them.

Importing the package costs nothing but the packet codec: python-can and zenoh are imported by the link that needs them,
numpy by the network laws.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Final

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

if TYPE_CHECKING:
    from transport.age_laws import ConstantAge, IidAge, MarkovAge
    from transport.contract import check_link
    from transport.draws import REASONS, Draw
    from transport.impairment import Impairment, impair
    from transport.packet_laws import GilbertElliott, PacketLaw
    from transport.semi_markov_law import SemiMarkovAge
    from transport.trace_law import TraceAge

_LAZY: Final = {
    "REASONS": "draws",
    "ConstantAge": "age_laws",
    "Draw": "draws",
    "GilbertElliott": "packet_laws",
    "IidAge": "age_laws",
    "Impairment": "impairment",
    "MarkovAge": "age_laws",
    "PacketLaw": "packet_laws",
    "SemiMarkovAge": "semi_markov_law",
    "TraceAge": "trace_law",
    "check_link": "contract",
    "impair": "impairment",
}

__all__ = [
    "EMPTY",
    "MORE",
    "REASONS",
    "SELECTIONS",
    "ConstantAge",
    "ControlPacket",
    "Draw",
    "GilbertElliott",
    "IidAge",
    "Impairment",
    "Link",
    "LinkCounters",
    "MarkovAge",
    "MemoryLink",
    "PacketLaw",
    "Role",
    "SemiMarkovAge",
    "SensorPacket",
    "TraceAge",
    "TransportError",
    "check_link",
    "dbc_path",
    "decode",
    "encode_control",
    "encode_sensor",
    "impair",
    "memory_pair",
    "open_link",
]


def __getattr__(name: str) -> object:
    if name not in _LAZY:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_LAZY[name]}"), name)


def dbc_path() -> Path:
    """Return the DBC file that names every signal of every frame, for `cantools` and other CAN tools.

    >>> dbc_path().name
    'hilrig.dbc'
    """
    return Path(__file__).with_name("hilrig.dbc")
