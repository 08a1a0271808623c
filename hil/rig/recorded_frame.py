"""A recorded CAN frame as a line of an experiment: ``12000000 123#1122``, nanoseconds and the frame as candump writes it."""

from __future__ import annotations

import re
from typing import Final

from transport.can_bus_model.bits import CanFrame
from transport.can_bus_model.traffic import Due
from transport.wire.fields import frame_length

MOST: Final = 100_000
_LINE: Final = re.compile(r"(\d{1,18}) ([0-9A-F]{3}|[0-9A-F]{8})(#R([0-8]?)|##([0-3])([0-9A-F]*)|#([0-9A-F]*))")


def line_of(at_ns: int, frame: CanFrame) -> str:
    """Return the line of a frame.

    >>> line_of(12_000_000, CanFrame(identifier=0x123, data=b"12"))
    '12000000 123#3132'
    """
    identifier = f"{frame.identifier:08X}" if frame.extended else f"{frame.identifier:03X}"
    if frame.remote:
        return f"{at_ns} {identifier}#R{frame.dlc or ''}"
    flags = f"#{frame.bitrate_switch | frame.error_state << 1}" if frame.fd else ""
    return f"{at_ns} {identifier}#{flags}{frame.data.hex().upper()}"


def due_of(line: str, node: int = 0) -> Due:
    """Return the frame of a line.

    Args:
        line: of `line_of`.
        node: who sends it.

    Raises:
        ValueError: it is none.
    """
    found = _LINE.fullmatch(line)
    if found is None:
        raise ValueError(f"{line!r:.60}, expected nanoseconds and a frame, as in '12000000 123#1122'")
    at, identifier, kind, dlc, flags, flexible, classic = found.groups()
    number, extended = int(identifier, 16), len(identifier) == 8
    if kind.startswith("#R"):
        return Due(int(at), node, CanFrame(identifier=number, extended=extended, remote=True, dlc=int(dlc or 0)))
    if flags is not None:
        data = bytes.fromhex(flexible)
        frame = CanFrame(
            identifier=number, extended=extended, fd=True, data=data.ljust(frame_length(min(len(data), 64)), b"\0"),
            bitrate_switch=bool(int(flags) & 1), error_state=bool(int(flags) & 2),
        )  # fmt: skip
        return Due(int(at), node, frame)
    return Due(int(at), node, CanFrame(identifier=number, extended=extended, data=bytes.fromhex(classic)))
