"""A CAN frame as a datagram between participants of the `hil` bus, and as a frame with bits."""

from __future__ import annotations

from struct import Struct
from typing import Final

from transport.can_bus_model.can_frame import CanFrame
from transport.wire.fields import frame_length

FRAME: Final = Struct("<dHIBB")
"""Time stamp, frames lost before (see `transport.links.mesh_peer.HEAD`); identifier with flags, length, FD flags; then data."""

# The bits of <linux/can.h>.
EXTENDED: Final = 0x80000000
REMOTE: Final = 0x40000000
ERROR: Final = 0x20000000
ID_MASK: Final = 0x1FFFFFFF
BITRATE_SWITCH: Final = 0x01
ERROR_STATE: Final = 0x02
FD_FRAME: Final = 0x04
OWN: Final = 0x80
LOOK: Final = 0x40
"""Flags of ours: a frame of one's own; no frame, but a word that the error state of a participant has changed."""


def frame_of(identifier: int, length: int, flags: int, data: bytes | bytearray) -> CanFrame:
    """Return what travels of a frame; CAN FD data are padded to a length that a frame has."""
    fd, remote = bool(flags & FD_FRAME), bool(identifier & REMOTE)
    padded = b"" if remote else bytes(data).ljust(frame_length(len(data)) if fd else len(data), b"\0")
    return CanFrame(
        identifier=identifier & ID_MASK, extended=bool(identifier & EXTENDED), remote=remote, data=padded, fd=fd,
        dlc=min(length, 8) if remote else None,
        bitrate_switch=fd and bool(flags & BITRATE_SWITCH), error_state=fd and bool(flags & ERROR_STATE),
    )  # fmt: skip
