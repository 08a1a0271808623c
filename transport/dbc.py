"""The DBC of some sensor nodes and a controller: one message per identifier, every value by its name.

`transport/hilrig.dbc` is the DBC of one node whose values have no names. The layout is that of `transport.wire`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from itertools import count
from math import isfinite
from typing import Any, Final, NamedTuple

from msgspec import Struct

from transport.errors import FieldError
from transport.wire import CONTROL, SELECTIONS, SENSOR, control_length, sensor_length

LONGEST_NAME: Final = 32
"""Characters of a name that other tools take."""
_SINGLE: Final = "3.4E+38"  # the largest float32; no other signal reaches so far
_WORDS: Final = r'"(?:\\"|[^"])*+"?|//[^\n]*'
"""Texts and comments of a DBC; in a text a colon may stand before any number."""
_TOO_LONG: Final = r":\s*[-+]?\d{6,}|\|\s*[-+]?\d{6,}\s*@"
"""Length of a message, start or length of a signal; cantools keeps every bit of a message in a list."""


def read_dbc(text: str) -> Any:
    """Return the `cantools` database of a DBC.

    Args:
        text: of any origin.

    Raises:
        ValueError: it is no DBC.
    """
    import cantools

    code = re.sub(_WORDS, lambda found: " " if found[0].startswith("//") or found[0].endswith('"') else found[0], text)
    beyond = re.search(_TOO_LONG, code)
    if beyond is not None:
        raise ValueError(f"is no DBC: {beyond[0][:80]!r}: no message has so many bits")
    try:
        return cantools.database.load_string(text, "dbc", strict=False)
    except Exception as error:  # of any kind, from whatever stands in the file
        raise ValueError(f"is no DBC: {str(error).partition(chr(10))[0]:.200}") from error


def check_places(message: Any) -> None:
    """Refuse a message of `cantools` whose signals overlap or stand beyond its end: no frame could be made of it.

    Raises:
        ValueError: with what `cantools` says.
    """
    try:
        message.refresh(strict=True)
    except Exception as error:  # its own errors have no class in common with ours
        raise ValueError(f"message {message.name}: {error}") from error


def start_numbers(message: Any) -> dict[str, float]:
    """Return what travels in each signal of a message of `cantools` by default: its start value (GenSigStartValue), else 0.

    Args:
        message: of a database of `read_dbc`; of another start value than its signal can hold the nearest is taken.
    """
    found: dict[str, float] = {}
    for signal in message.signals:
        number, top = float(signal.raw_initial or 0), 2 ** (signal.length - bool(signal.is_signed)) - 1
        whole = round(min(max(number, -top - 1 if signal.is_signed else 0), top)) if isfinite(number) else 0
        found[signal.name] = number if signal.is_float else whole
    return found


class _Signal(NamedTuple):
    name: str
    start: int  # bit, from the packet's first
    bits: int
    sign: str = "+"
    top: str = ""
    unit: str = ""
    mux: str = ""


_SENSOR_HEAD: Final = (
    _Signal("Crc", 0, 16), _Signal("Kind", 16, 8), _Signal("Outputs", 24, 6), _Signal("More", 30, 1), _Signal("Empty", 31, 1),
    _Signal("Seq", 32, 32), _Signal("Nonce", 64, 64, "+", "1.8E+19"), _Signal("SampleTime", 128, 64, "-", "9.2E+18", "ns"),
    _Signal("Node", 192, 8), _Signal("Samples", 200, 8), _Signal("References", 208, 7), _Signal("Tagged", 215, 1),
    _Signal("Nodes", 216, 8), _Signal("Counter", 224, 32),
)  # fmt: skip
_CONTROL_HEAD: Final = (
    _Signal("Crc", 0, 16), _Signal("Kind", 16, 8), _Signal("Selection", 24, 7), _Signal("Tagged", 31, 1), _Signal("Seq", 32, 32),
    _Signal("Echo", 64, 64, "+", "1.8E+19"), _Signal("SampleTime", 128, 64, "-", "9.2E+18", "ns"),
    _Signal("ControlTime", 192, 64, "-", "9.2E+18", "ns"), _Signal("Tau", 256, 16, "-", "32767", "samples"),
    _Signal("Rows", 272, 8), _Signal("Inputs", 280, 8), _Signal("Counter", 288, 32),
)  # fmt: skip
_FORMATS: Final = ",".join(
    f'"{word}"'
    for word in ("StandardCAN", "ExtendedCAN", "reserved", "J1939PG", *["reserved"] * 10, "StandardCAN_FD", "ExtendedCAN_FD")
)


class BusNode(Struct, frozen=True, kw_only=True):
    """Who sends packets of one shape.

    Args:
        name: of its messages: letters, digits and _.
        about: a comment on them.
        identifiers: fragment i has the entry i.
        values: name and unit of each value, in their order; names of signals are unique within a message only.
        references: sensor nodes: how many of the last values are references; an EMPTY packet carries these alone.
        sensor: whether it sends sensor packets, or control packets.
    """

    name: str
    about: str
    identifiers: range
    values: tuple[tuple[str, str], ...]
    references: int = 0
    sensor: bool = True


def _quoted(text: str) -> str:
    """Return a text as it may stand between the quotes of a DBC, which has no escapes.

    >>> _quoted('a "motor"')
    "a 'motor'"
    """
    return "".join({'"': "'", "\\": "/"}.get(c, c if c.isprintable() else " ") for c in text)


def dbc_text(senders: Sequence[BusNode], *, fd: bool, title: str) -> str:
    """Return a DBC.

    Args:
        senders: the sensor nodes and the controller.
        fd: CAN FD or classic frames.
        title: what stands in VERSION.

    Raises:
        ValueError: a packet that has more fragments than identifiers.
    """
    blocks = [list(_messages(bus_node, fd)) for bus_node in senders]
    known = [f"\t{word}" for word in ("CM_", "BA_DEF_", "BA_", "VAL_", "BA_DEF_DEF_", "SIG_VALTYPE_")]
    lines = [f'VERSION "{_quoted(title)}"', "", "NS_ :", *known, "", "BS_:", "", "BU_: Rig Controller"]
    kinds = ('BA_DEF_ "BusType" STRING ;', f'BA_DEF_ BO_ "VFrameFormat" ENUM {_FORMATS} ;')
    defaults = ('BA_DEF_DEF_  "BusType" "CAN";', 'BA_DEF_DEF_  "VFrameFormat" "StandardCAN";')
    comments, formats, words, floats = [], [], [], []
    for bus_node, messages in zip(senders, blocks, strict=True):
        transmitter, other = ("Rig", "Controller") if bus_node.sensor else ("Controller", "Rig")
        for index, (identifier, name, length, signals) in enumerate(messages):
            lines += ["", f"BO_ {identifier} {name}: {length} {transmitter}"]
            lines += [_line(signal, other) for signal in signals]
            floats += [f"SIG_VALTYPE_ {identifier} {s.name} : 1;" for s in signals if s.top == _SINGLE]
            formats += [f'BA_ "VFrameFormat" BO_ {identifier} 14;'] * fd
            if not index:
                comments.append(f'CM_ BO_ {identifier} "{_quoted(bus_node.about)}";')
                kind = f'{SENSOR} "sensor"' if bus_node.sensor else f'{CONTROL} "control"'
                words.append(f"VAL_ {identifier} Kind {kind} ;")
                if not bus_node.sensor:
                    said = " ".join(f'{code} "{word}"' for code, word in enumerate(SELECTIONS))
                    words.append(f"VAL_ {identifier} Selection {said} ;")
    bus = [f'BA_ "BusType" "{"CAN FD" if fd else "CAN"}";']
    return "\n".join([*lines, "", *comments, *kinds, *defaults, *bus, *formats, *words, *floats, ""])


def _messages(bus_node: BusNode, fd: bool) -> Iterator[tuple[int, str, int, list[_Signal]]]:
    step = 64 if fd else 8
    values = len(bus_node.values)
    size = sensor_length(values) if bus_node.sensor else control_length(values)
    if -(-size // step) > len(bus_node.identifiers):
        raise FieldError(bus_node.name, f"{-(-size // step)} frames, and {len(bus_node.identifiers)} identifiers")
    signals = list(_SENSOR_HEAD if bus_node.sensor else _CONTROL_HEAD)
    first = 8 * (32 if bus_node.sensor else 40)
    alone = bus_node.sensor and fd and 0 < bus_node.references <= 8  # else no message holds both Empty and the values
    for i, (name, unit) in enumerate(bus_node.values):
        at = first + 32 * i
        signals.append(_Signal(name, at, 32, "-", _SINGLE, unit, "m0" if alone and at < 512 else ""))
    if alone:
        for i, (name, unit) in enumerate(bus_node.values[values - bus_node.references :]):
            signals.append(_Signal(f"{name}_alone"[:LONGEST_NAME], first + 32 * i, 32, "-", _SINGLE, unit, "m1"))
        signals = [signal._replace(mux="M") if signal.name == "Empty" else signal for signal in signals]
    for index, identifier in zip(count(), bus_node.identifiers):
        begin = 8 * step * index
        own = [signal._replace(start=signal.start - begin) for signal in signals if 0 <= signal.start - begin < 8 * step]
        if begin >= 8 * size:
            return
        yield identifier, f"{bus_node.name}{'FD' if fd else ''}{index}", step, own


def _line(signal: _Signal, receiver: str) -> str:
    top = signal.top or str(2**signal.bits - 1)
    low = {"+": "0", "-": "-32768" if signal.bits == 16 else f"-{top}"}[signal.sign]
    mux = f" {signal.mux}" if signal.mux else ""
    where = f"{signal.start}|{signal.bits}@1{signal.sign} (1,0) [{low}|{top}]"
    return f' SG_ {signal.name}{mux} : {where} "{_quoted(signal.unit)}" {receiver}'
