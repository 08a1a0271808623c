"""Packets, the links that carry them, and the network laws that delay and lose them.

Importing the package costs nothing: each name brings its module when it is first used; python-can and zenoh are imported by
the link that needs them, numpy by the network laws.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from transport.draws import REASONS, Draw
    from transport.laws.age import ConstantAge, IidAge, MarkovAge
    from transport.laws.packet import GilbertElliott, PacketLaw
    from transport.laws.semi_markov import SemiMarkovAge
    from transport.laws.trace import TraceAge
    from transport.links.contract import check_link
    from transport.links.link import Link, LinkCounters, Role, TransportError
    from transport.links.memory import MemoryLink, memory_pair
    from transport.links.opening import open_link
    from transport.links.traits import CanFraming, LinkTraits, SaysTraits
    from transport.medium.independent import Impairment, impair
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

_HOMES: Final = {
    "CanFraming": "transport.links.traits",
    "ConstantAge": "transport.laws.age",
    "ControlPacket": "transport.packets",
    "Draw": "transport.draws",
    "EMPTY": "transport.packets",
    "GilbertElliott": "transport.laws.packet",
    "IidAge": "transport.laws.age",
    "Impairment": "transport.medium.independent",
    "Link": "transport.links.link",
    "LinkCounters": "transport.links.link",
    "LinkTraits": "transport.links.traits",
    "MORE": "transport.packets",
    "MarkovAge": "transport.laws.age",
    "MemoryLink": "transport.links.memory",
    "PacketLaw": "transport.laws.packet",
    "REASONS": "transport.draws",
    "Role": "transport.links.link",
    "SELECTIONS": "transport.packets",
    "SemiMarkovAge": "transport.laws.semi_markov",
    "SaysTraits": "transport.links.traits",
    "SensorPacket": "transport.packets",
    "TraceAge": "transport.laws.trace",
    "TransportError": "transport.links.link",
    "check_link": "transport.links.contract",
    "decode": "transport.packets",
    "encode_control": "transport.packets",
    "encode_sensor": "transport.packets",
    "impair": "transport.medium.independent",
    "memory_pair": "transport.links.memory",
    "open_link": "transport.links.opening",
}

__all__ = [
    "EMPTY",
    "MORE",
    "REASONS",
    "SELECTIONS",
    "CanFraming",
    "ConstantAge",
    "ControlPacket",
    "Draw",
    "GilbertElliott",
    "IidAge",
    "Impairment",
    "Link",
    "LinkCounters",
    "LinkTraits",
    "MarkovAge",
    "MemoryLink",
    "PacketLaw",
    "Role",
    "SaysTraits",
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


if not TYPE_CHECKING:  # a type checker shall tell a name that is not there

    def __getattr__(name: str) -> object:
        if name not in _HOMES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


def dbc_path() -> Path:
    """Return the DBC file that names every signal of every frame, for `cantools` and other CAN tools.

    >>> dbc_path().name
    'hilrig.dbc'
    """
    return Path(__file__).with_name("hilrig.dbc")
