"""The record of what a network law decided: one `Draw` for every decision about a slot or a packet."""

from __future__ import annotations

from typing import Final, NamedTuple

REASONS: Final[tuple[str, ...]] = (
    "delivered",  # arrives for the first time, newer than all before
    "repeated",  # age law: the newest packet of an earlier slot is still the newest
    "disordered",  # arrives for the first time, after a newer one
    "duplicated",  # the second copy of a packet that has arrived already
    "superseded",  # age law: never was the newest at the receiver, and never can be
    "lost",  # the loss law took it
    "overflow",  # more packets in flight than the stated queue holds
    "none-yet",  # the law points before the first slot
    "absent",  # the law points at a packet that was never offered (late or not sent)
    "sent",  # packet law: on its way, with this latency
    "copied",  # packet law: a second copy on its way, with its own latency
    "replaced",  # on a bus with arbitration: a newer packet of its node took its place before the bus was free
    "cut",  # a fault on the time line: it would have arrived while the link was cut
    "corrupted",  # a fault on the time line: it arrived with a flipped bit, and the receiver's CRC refused it
    "off-bus",  # a fault on the time line: its sender, or its receiver, was off the bus
)
"""Names of the reason codes: `REASONS[draw.reason]`."""

DELIVERED: Final = 0
REPEATED: Final = 1
DISORDERED: Final = 2
DUPLICATED: Final = 3
SUPERSEDED: Final = 4
LOST: Final = 5
OVERFLOW: Final = 6
NONE_YET: Final = 7
ABSENT: Final = 8
SENT: Final = 9
COPIED: Final = 10
REPLACED: Final = 11
CUT: Final = 12
CORRUPTED: Final = 13
OFF_BUS: Final = 14

NO_MODE: Final = -1
"""`Draw.mode` of a row that books a packet's fate and is no draw of the law."""


class Draw(NamedTuple):
    """One decision of an emulated network.

    Rows with `mode >= 0` are the draws of the law: exactly one per slot, in slot order, for both families of law. Rows
    with `mode == NO_MODE` book what became of a packet: arrivals of a packet law, superseded packets, stand-ins for
    absent ones.

    Attributes:
        slot: slot k in which it was decided.
        packet_slot: slot g in which the packet was sent, -1 when there is no packet; on a bus with arbitration the slot of its
            newest sample, from which on it waited for the bus.
        mode: mode of the law, or `NO_MODE`.
        age: slots; in a draw of an age law the age that the law demands, otherwise `slot - packet_slot`
            (for "sent" and "copied": at arrival; on a bus with arbitration: since the bus carried it); -1 where it has no
            meaning.
        latency_s: seconds on the way; for age laws age times T; NaN where it has no meaning.
        reason: index into `REASONS`.
    """

    slot: int
    packet_slot: int
    mode: int
    age: int
    latency_s: float
    reason: int
