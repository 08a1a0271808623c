"""What a record of the log is: fields, units, and how it becomes bytes. The topics stand in `hil.log.topics`.

Every signal record is a ROS 2 message (``ros2msg`` text as schema) in CDR, little endian. Fields are ordered float64,
int64, int32, uint8, so that the packed layout *is* the aligned layout of CDR: one ``struct`` writes a record and one
``numpy`` dtype reads thousands. Only raw frames have a part of variable length, ``uint8[] data``, always last.

The log time of a record is the nominal session time of its slot, in real time counted from the wall-clock instant at which
the session began. Its publish time is when it happened: in virtual time the same instant, in real time what was measured. The
fields never repeat them.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cached_property, partial
from struct import Struct
from typing import Any, Final

import msgspec
import numpy as np

from hil.errors import HilError

CDR_HEADER: Final = b"\x00\x01\x00\x00"
"""Encapsulation header of plain CDR, little endian (OMG DDSI-RTPS 2.3, table 10.3)."""

EVENTS_TOPIC: Final = "/events"

TIME_FIELD: Final = "t_ns"
"""Field of a run's arrays that holds the log time; no schema has it."""

STATUS: Final = ("ok", "hold", "none yet", "safe state")
"""Names of ``/actuator/applied.status``."""

SEVERITIES: Final = ("debug", "info", "warning", "error")

EVENT_SCHEMA_NAME: Final = "hil/msg/Event"
EVENT_SCHEMA: Final = f"""\
float64 t_s  # s, nominal session time
int64 slot  # 1, slot in which it happened, -1 outside of slots
string kind  # 1, short name to filter by
string severity  # 1, one of {', '.join(SEVERITIES)}
string message  # 1, one sentence for people
string data  # 1, values that belong to it, as a JSON object; numbers that are not finite as text
"""
"""``ros2msg`` text of ``/events``; see `hil.log.encode_event`."""

_CODES: Final = {"float64": "d", "int64": "q", "int32": "i", "uint8": "B"}
_NUMPY: Final = {"float64": "<f8", "int64": "<i8", "int32": "<i4", "uint8": "u1"}
_ORDER: Final = ("float64", "int64", "int32", "uint8", "uint8[]")
_FIELD_NAME: Final = re.compile(r"(?!.*__)(?!.*_$)[a-z][a-z0-9_]*")
_SCHEMA_NAME: Final = re.compile(r"[a-z][a-z0-9_]*/msg/[A-Z][A-Za-z0-9]*")
_LINE: Final = r"(?P<type>\S+) (?P<name>\S+)(?:  # (?P<unit>[^,]*)(?:, (?P<doc>.*))?)?"


class Field(msgspec.Struct, frozen=True, kw_only=True):
    """One field of a record.

    Args:
        type: ``float64``, ``int64``, ``int32``, ``uint8`` or, as the last field only, ``uint8[]``.
        name: ROS 2 field name: lower case letters, digits and single underscores.
        unit: unit without a comma, ``1`` for none.
        doc: one line for the reader of the schema.
    """

    type: str
    name: str
    unit: str = "1"
    doc: str = ""

    def __post_init__(self) -> None:
        if self.type not in _ORDER:
            raise ValueError(f"type: {self.type!r}, expected one of {', '.join(_ORDER)}")
        if not _FIELD_NAME.fullmatch(self.name):
            raise ValueError(f"name: {self.name!r:.80} is no ROS 2 field name (lower case, digits, single underscores)")
        if "," in self.unit or "\n" in self.unit + self.doc:
            raise ValueError(f"unit: {self.unit!r} or its doc holds a comma or a line break")

    @property
    def line(self) -> str:
        """The field as one line of ``ros2msg``."""
        return f"{self.type} {self.name}  # {self.unit}" + (f", {self.doc}" if self.doc else "")


class Schema(msgspec.Struct, frozen=True, kw_only=True, dict=True):
    """A record's layout, and the two ways through it: ``pack`` to bytes, ``dtype`` back to numbers.

    Args:
        name: ``package/msg/Name``.
        fields: ordered float64, int64, int32, uint8, uint8[].

    >>> s = Schema(name="hil/msg/Demo", fields=(Field(type="float64", name="angle", unit="rad"),
    ...                                         Field(type="uint8", name="late")))
    >>> s.pack(1.0, 1).hex()
    '00010000000000000000f03f01'
    >>> print(s.text, end="")
    float64 angle  # rad
    uint8 late  # 1
    """

    name: str
    fields: tuple[Field, ...]

    def __post_init__(self) -> None:
        if not _SCHEMA_NAME.fullmatch(self.name):
            raise ValueError(f"name: {self.name!r}, expected package/msg/Name")
        ranks = [_ORDER.index(f.type) for f in self.fields]
        if not ranks or ranks != sorted(ranks) or ranks.count(4) > 1:
            raise ValueError(f"fields: {self.name} must be ordered {', '.join(_ORDER)}, with one uint8[] at most")
        taken = set[str]()
        for f in self.fields:
            if f.name in taken:
                raise ValueError(f"fields: {self.name} has more than one field {f.name!r}")
            taken.add(f.name)

    @property
    def text(self) -> str:
        """Its fields as ``ros2msg`` has them."""
        return "".join(f.line + "\n" for f in self.fields)

    @cached_property
    def dtype(self) -> np.dtype[np.void]:
        """The fields in numpy, without ``uint8[]``."""
        return np.dtype([(f.name, _NUMPY[f.type]) for f in self.fields if f.type != "uint8[]"])

    @property
    def raw(self) -> bool:
        """Whether it ends with ``uint8[]``."""
        return self.fields[-1].type == "uint8[]"

    @cached_property
    def pack(self) -> Callable[..., bytes]:
        """What makes the bytes of a record of its values."""
        if self.raw:
            # The length of a sequence is a u32 and aligned as such, counted from the end of the CDR header.
            return _raw_packer(Struct(f"<4s{self.codes}{-self.dtype.itemsize % 4}xI").pack)
        return partial(Struct(f"<4s{self.codes}").pack, CDR_HEADER)

    @property
    def floats(self) -> list[str]:
        """Names of its fields of type float64, in order."""
        return [field.name for field in self.fields if field.type == "float64"]

    @property
    def codes(self) -> str:
        """The numbers of a record as `struct` writes them, behind the CDR header."""
        return "".join(_CODES[f.type] for f in self.fields if f.type != "uint8[]")

    @property
    def data_offset(self) -> int:
        """Where the bytes of ``uint8[]`` begin in a payload (its u32 length stands just before)."""
        return 4 + self.dtype.itemsize + -self.dtype.itemsize % 4 + 4

    @classmethod
    def from_text(cls, name: str, text: str) -> Schema:
        """Read back what ``text`` wrote; raises ValueError for anything that this table could not have written."""
        found = []
        for number, line in enumerate(text.splitlines(), 1):
            match = re.fullmatch(_LINE, line)
            if match is None:
                raise ValueError(f"{name}: line {number} is no field: {line[:80]!r}")
            found.append(Field(**{key: value or "" for key, value in match.groupdict().items()}))
        return cls(name=name, fields=tuple(found))


def _raw_packer(pack: Callable[..., bytes]) -> Callable[..., bytes]:
    def packer(*values: Any) -> bytes:
        data: bytes = values[-1]
        return pack(CDR_HEADER, *values[:-1], len(data)) + data

    return packer


class Channel(msgspec.Struct, frozen=True, kw_only=True):
    """A topic of the log.

    Args:
        id: number of the channel in the file and in the pipe, from 1.
        topic: name of the channel.
        schema: layout of its records.
    """

    id: int
    topic: str
    schema: Schema


def field_name(name: str) -> str:
    """ROS 2 field name for a signal's name.

    Runs of other characters than letters and digits become one underscore, capitals become small.

    Raises:
        HilError: if nothing usable remains, if it would begin with a digit, or if it is ``t_ns``.

    >>> field_name("Motor speed (left)")
    'motor_speed_left'
    """
    clean = re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")
    if clean == TIME_FIELD:
        raise HilError(f"signal {name!r}: {TIME_FIELD!r} is the log's own name for the time of a record")
    if not _FIELD_NAME.fullmatch(clean):
        raise HilError(f"signal {name!r}: cannot be the name of a log field, expected letters first, then letters,"
                       " digits and underscores")
    return clean
