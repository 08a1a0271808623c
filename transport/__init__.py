"""Packets, the links that carry them, and the network laws that delay and lose them.

Importing the package costs nothing: each name brings its module when it is first used; python-can and zenoh are imported by
the link that needs them, numpy by the network laws.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Final

_NAMES: Final = {
    "transport.draws": "Draw REASONS",
    "transport.laws.age": "ConstantAge IidAge MarkovAge",
    "transport.laws.packet": "GilbertElliott PacketLaw",
    "transport.laws.semi_markov": "SemiMarkovAge",
    "transport.laws.trace": "TraceAge",
    "transport.links.contract": "check_link",
    "transport.links": "Link LinkCounters Role TransportError",
    "transport.links.memory": "MemoryLink memory_pair",
    "transport.links.opening": "open_link",
    "transport.links.traits": "CanFraming LinkTraits SaysTraits",
    "transport.medium.independent": "Impairment impair",
    "transport.packets": "ControlPacket EMPTY MORE SELECTIONS SensorPacket decode encode_control encode_sensor",
}
"""Module to the public names that it brings; `__init__.pyi` has the same ones for type checkers."""

_HOMES = {name: module for module, names in _NAMES.items() for name in names.split()}

__all__ = sorted([*_HOMES, "dbc_path"])  # noqa: PLE0605


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
