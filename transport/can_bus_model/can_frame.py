"""A CAN frame as a node hands it to its controller, and what it is worth in arbitration."""

from __future__ import annotations

from typing import Final

from msgspec import Struct

from transport.errors import FieldError
from transport.wire import FD_LENGTHS

BASE_MOST: Final = 0x7FF
EXTENDED_MOST: Final = 0x1FFF_FFFF


class CanFrame(Struct, frozen=True, kw_only=True):
    """A data or remote frame of classic CAN or CAN FD.

    Args:
        identifier: 11 bits, or 29 where ``extended``.
        data: 0 to 8 bytes; with ``fd`` one of 0 to 8, 12, 16, 20, 24, 32, 48, 64.
        extended: whether the identifier has 29 bits.
        remote: a request without data; classic CAN only.
        dlc: length that a remote frame asks for; None otherwise.
        fd: CAN FD.
        bitrate_switch: whether data and CRC travel at the data bit rate; with ``fd`` only.
        error_state: the ESI bit: the sender is error passive; with ``fd`` only.

    Raises:
        ValueError: a value that no frame has; the message begins with its field.
    """

    identifier: int
    data: bytes = b""
    extended: bool = False
    remote: bool = False
    dlc: int | None = None
    fd: bool = False
    bitrate_switch: bool = False
    error_state: bool = False

    def __post_init__(self) -> None:
        most = EXTENDED_MOST if self.extended else BASE_MOST
        if not 0 <= self.identifier <= most:
            bits = 29 if self.extended else 11
            raise FieldError("identifier", f"{self.identifier:#x}, expected 0 to {most:#x} ({bits} bits)")
        if self.remote and (self.fd or self.data or not 0 <= (self.dlc or 0) <= 8):
            raise FieldError("remote", "a remote frame is a classic one, without data and with a DLC of 0 to 8")
        if not self.remote and self.dlc is not None:
            raise FieldError("dlc", f"{self.dlc}, expected none: only a remote frame asks for a length")
        if self.fd and len(self.data) not in FD_LENGTHS:
            allowed = ", ".join(map(str, FD_LENGTHS))
            raise FieldError("data", f"{len(self.data)} bytes, expected one of {allowed} in a CAN FD frame")
        if not self.fd and len(self.data) > 8:
            raise FieldError("data", f"{len(self.data)} bytes, expected at most 8 in a classic frame")
        if not self.fd and (self.bitrate_switch or self.error_state):
            raise FieldError("bitrate_switch", "a classic frame has neither the BRS nor the ESI bit, expected fd = true")

    @property
    def length_code(self) -> int:
        """The four bits of the DLC."""
        return (self.dlc or 0) if self.remote else FD_LENGTHS.index(len(self.data))


def arbitration_key(frame: CanFrame) -> int:
    """Return the bits that decide who sends, as one number: of two frames the smaller one wins.

    A base frame wins over an extended one with the same first 11 bits, a data frame over a remote one.

    >>> base, remote = CanFrame(identifier=1), CanFrame(identifier=1, remote=True)
    >>> extended = CanFrame(identifier=1 << 18, extended=True)
    >>> arbitration_key(base) < arbitration_key(remote) < arbitration_key(extended)
    True
    """
    if frame.extended:
        first, second = frame.identifier >> 18, frame.identifier & 0x3FFFF
        return first << 21 | 0b11 << 19 | second << 1 | frame.remote
    return frame.identifier << 21 | frame.remote << 20
