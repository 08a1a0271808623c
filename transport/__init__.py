"""Packets, the links that carry them, and the network laws that delay and lose them.

Importing the package costs nothing: each name brings its module when it is first used; python-can and zenoh are imported by
the link that needs them, numpy by the network laws.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

TYPE_CHECKING = False  # the import of typing takes time
if TYPE_CHECKING:
    from transport.draws import REASONS as REASONS
    from transport.draws import Draw as Draw
    from transport.laws.age import ConstantAge as ConstantAge
    from transport.laws.age import IidAge as IidAge
    from transport.laws.age import MarkovAge as MarkovAge
    from transport.laws.packet import GilbertElliott as GilbertElliott
    from transport.laws.packet import PacketLaw as PacketLaw
    from transport.laws.semi_markov import SemiMarkovAge as SemiMarkovAge
    from transport.laws.trace import TraceAge as TraceAge
    from transport.links import Link as Link
    from transport.links import LinkCounters as LinkCounters
    from transport.links import Role as Role
    from transport.links import TransportError as TransportError
    from transport.links.contract import MemoryLink as MemoryLink
    from transport.links.contract import check_link as check_link
    from transport.links.contract import memory_pair as memory_pair
    from transport.links.opening import open_link as open_link
    from transport.links.traits import CanFraming as CanFraming
    from transport.links.traits import LinkTraits as LinkTraits
    from transport.links.traits import SaysTraits as SaysTraits
    from transport.medium.independent import Impairment as Impairment
    from transport.medium.independent import impair as impair
    from transport.packets import EMPTY as EMPTY
    from transport.packets import MORE as MORE
    from transport.packets import SELECTIONS as SELECTIONS
    from transport.packets import ControlPacket as ControlPacket
    from transport.packets import SensorPacket as SensorPacket
    from transport.packets import decode as decode
    from transport.packets import encode_control as encode_control
    from transport.packets import encode_sensor as encode_sensor

with open(f"{__path__[0]}/__init__.py", encoding="utf-8") as _face:
    _HOMES = {words[3]: words[1] for words in map(str.split, _face) if words[0:1] + words[4:5] == ["from", "as"]}
"""Module of each public name, as the imports for type checkers have them."""

__all__ = sorted([*_HOMES, "dbc_path"])  # noqa: PLE0605


if not TYPE_CHECKING:

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
