"""What travels: the fields of sensor and control packets, and the lengths of frames."""

from __future__ import annotations

from collections.abc import Callable
from math import copysign, inf
from struct import Struct
from typing import Final, NamedTuple, TypeAlias, TypeVar

from transport.errors import FieldError

MORE: Final = 1
"""Sensor flag: further frames of the same slot follow."""
EMPTY: Final = 2
"""Sensor flag: nothing arrived in this slot, the packet carries no measurement."""

SELECTIONS: Final = ("constant", "generated", "applied", "previous", "both")
"""How the actuator picks a row; the wire code is the index."""

MAX_OUTPUTS: Final = 63
MAX_ROWS: Final = 255
MAX_INPUTS: Final = 255
TAU_LIMIT: Final = 32767
"""Larger ages are sent as this one."""

FD_LENGTHS: Final = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
"""The payload lengths that a CAN FD frame can have."""
_LENGTHS: Final = tuple(next(length for length in FD_LENGTHS if length >= size) for size in range(65))

CRC_START: Final = 0xFFFF


class SensorPacket(NamedTuple):
    """One measurement on its way to the controller.

    Attributes:
        seq: slot k in which the frame is sent (u32, wraps).
        flags: sum of ``MORE`` and ``EMPTY``.
        sample_ns: nominal session time of the newest sample, ns; the samples before it are one period older each.
        y: measurements, newest sample first, float32 on the wire; empty if and only if ``EMPTY`` is set.
        node: number of the sensor node that measured, from 0.
        samples: samples that y holds, each of ``len(y) / samples`` outputs.
        reference: reference of all outputs in slot k, float32 on the wire.
        nodes: number of sensor nodes of the rig.
        nonce: of session and slot (u64), 0 in virtual time.
        counter: of the frames that its sender has sent (u32); it begins anew with slot 0.
        tag: truncated message authentication code, 8 bytes, empty where the packet is not authenticated.
    """

    seq: int
    flags: int
    sample_ns: int
    y: tuple[float, ...]
    node: int = 0
    samples: int = 1
    reference: tuple[float, ...] = ()
    nodes: int = 1
    nonce: int = 0
    counter: int = 0
    tag: bytes = b""


class ControlPacket(NamedTuple):
    """One row of inputs for every delay the actuator may find: *send all, apply one*.

    Attributes:
        seq: slot k that is answered (u32, wraps).
        sample_ns: nominal session time of the newest sample used, ns.
        control_ns: session time at which the rows were computed, ns.
        tau: measured sensor-to-controller delay in samples, -1 while there is no sample; saturates at ``TAU_LIMIT``.
        selection: index into ``SELECTIONS``.
        rows: inputs, shape (rows, m), float32 on the wire.
        echo: digest of the frames that are answered (u64), see `transport.wire.echo`; 0 in virtual time.
        counter, tag: as in `SensorPacket`.
    """

    seq: int
    sample_ns: int
    control_ns: int
    tau: int
    selection: int
    rows: tuple[tuple[float, ...], ...]
    echo: int = 0
    counter: int = 0
    tag: bytes = b""


Packet = TypeVar("Packet", SensorPacket, ControlPacket)
Reader: TypeAlias = tuple[int, Callable[[bytes], Packet | None]]
"""Length of a packet, and what reads its bytes."""


class Layout(NamedTuple):
    """One packet shape: writer and reader without CRC, and the length on the wire."""

    write: Struct
    read: Struct
    size: int


def check_control(count: int, inputs: int, selection: int) -> None:
    """Refuse rows or a selection that no control packet has.

    Raises:
        FieldError: more than 255 rows or inputs, rows without inputs, or a code that is none of `SELECTIONS`.
    """
    if count > MAX_ROWS or (count and not 0 < inputs <= MAX_INPUTS):
        raise FieldError("rows", f"{count} rows of {inputs}, expected up to {MAX_ROWS} rows of 1 to {MAX_INPUTS}")
    if not 0 <= selection < len(SELECTIONS):
        raise FieldError("selection", f"{selection}, expected a code from 0 to {len(SELECTIONS) - 1}")


def frame_length(size: int) -> int:
    """Shortest length of a CAN FD frame, or multiple of 8 above 64, that holds ``size`` bytes.

    >>> [frame_length(n) for n in (0, 8, 9, 20, 44, 64, 65)]
    [0, 8, 12, 20, 48, 64, 72]
    """
    return _LENGTHS[size] if size <= 64 else -(-size // 8) * 8


def single(value: float) -> float:
    """A number that float32 can hold: what is too large becomes an infinity, as in a conversion by hardware."""
    value = float(value)
    return value if abs(value) < 3.4028235e38 or value != value else copysign(inf, value)
