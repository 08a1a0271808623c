"""Which CAN identifiers the packets of a link have: those of each sensor node, and those of the control packets.

An identifier of 11 bits is a bit field, unless an experiment sets it:

===== ==================================================================================================
bits  say
===== ==================================================================================================
10-8  the link's base, 0x100 by default: two rigs on one bus have two bases
7     0 CAN FD, 1 classic frames
6     0 sensor packet, 1 control packet: sensor frames win the arbitration
5-0   the number of the node in as many upper bits as N nodes need, the number i of the fragment in the rest
===== ==================================================================================================

One node has the identifiers base + i. Of four nodes the third has base + 0x20 + i: its number stands in the bits 5 and 4. The
lower number wins the arbitration with all of its fragments. A tool that filters takes one node with the mask 0x7F0.

Fragments of a packet are sent in order, each with the identifier after that of the one before, as CANopen's TPDO1 to TPDOn.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain
from typing import Final

from msgspec import Struct

from transport.errors import FieldError
from transport.links import TransportError

BASE: Final = 0x100
FRAGMENTS: Final = 64
CLASSIC_OFFSET: Final = 0x80
CONTROL_OFFSET: Final = 0x40
BASES: Final = range(0, 0x800, 0x100)
LARGEST: Final = 0x7FF
"""The largest identifier of 11 bits."""

MESSAGES: Final = ("dbc", "outputs", "references", "inputs", "counters", "valid")
"""Options of a URI whose controller has messages of its own, see `transport.links.own_messages`."""

_RANGE: Final = "(0[xX][0-9a-fA-F]{1,8}|0|[1-9][0-9]{0,8})(?:-(0[xX][0-9a-fA-F]{1,8}|0|[1-9][0-9]{0,8}))?"


class Identifiers(Struct, frozen=True, kw_only=True):
    """The identifiers of a link: fragment i of a packet has the entry i of its range.

    Args:
        sensors: of each sensor node, by number.
        control: of the control packets.

    Raises:
        ValueError: identifiers of more than 11 bits, or two owners of one.
    """

    sensors: tuple[range, ...]
    control: range

    def __post_init__(self) -> None:
        owner: dict[int, str] = {}
        for name, own in self.named():
            if not own or own[0] < 0 or own[-1] > LARGEST:
                raise FieldError(name, f"identifiers {identifiers_text(own)}, expected 0 to {LARGEST:#x} (11 bits)")
            for identifier in own:
                if owner.setdefault(identifier, name) != name:
                    raise FieldError(name, f"the identifier {identifier:#x} is that of {owner[identifier]} already")

    def named(self) -> Iterator[tuple[str, range]]:
        """Give owner and identifiers: ``node 0``, ``node 1``, ..., ``control``."""
        yield from ((f"node {number}", own) for number, own in enumerate(self.sensors))
        yield "control", self.control

    def of(self, sender: str) -> tuple[range, ...]:
        """Return what the rig (``rig``) or the controller says."""
        return self.sensors if sender == "rig" else (self.control,)


def derived(base: int = BASE, fd: bool = True, nodes: int = 1) -> Identifiers:
    """Return the identifiers that are not set.

    Args:
        base: a multiple of 0x100.
        fd: CAN FD or classic frames.
        nodes: number of sensor nodes.

    Raises:
        ValueError: more nodes than there are identifiers.

    >>> [identifiers_text(own) for own in derived(nodes=4).sensors]
    ['0x100-0x10f', '0x110-0x11f', '0x120-0x12f', '0x130-0x13f']
    >>> [identifiers_text(own) for own in derived(0x200, fd=False).sensors], identifiers_text(derived().control)
    (['0x280-0x2bf'], '0x140-0x17f')
    """
    if not 1 <= nodes <= FRAGMENTS:
        raise FieldError("nodes", f"{nodes}, expected 1 to {FRAGMENTS}: there are no more identifiers below a base; set can_id")
    first, step = base + (0 if fd else CLASSIC_OFFSET), FRAGMENTS >> (nodes - 1).bit_length()
    control = first + CONTROL_OFFSET
    return Identifiers(
        sensors=tuple(range(first + n * step, first + (n + 1) * step) for n in range(nodes)),
        control=range(control, control + FRAGMENTS),
    )


def identifiers_text(own: range) -> str:
    """Return identifiers as a link's URI has them: ``0x141`` or ``0x141-0x143``."""
    return f"{own[0]:#x}" if len(own) == 1 else f"{own.start:#x}-{own.stop - 1:#x}"


def read_range(text: str) -> range:
    """Return the identifiers that `said` has written.

    Raises:
        ValueError: other text, an identifier above 11 bits, or more than a packet's fragments.

    >>> read_range("0x141-0x143")
    range(321, 324)
    """
    found = re.fullmatch(_RANGE, text)
    if found is None:
        raise FieldError("identifiers", f"{text!r:.40}, expected a number or two, as in 0x141 or 0x141-0x143")
    first = int(found[1], 0)
    last = first if found[2] is None else int(found[2], 0)
    if not first <= last <= LARGEST or last - first >= FRAGMENTS:
        raise FieldError("identifiers", f"{text!r:.40}, expected up to {FRAGMENTS} in ascending order, none above {LARGEST:#x}")
    return range(first, last + 1)


def filters(accepted: Sequence[range]) -> list[dict[str, int | bool]]:
    """Return the fewest acceptance filters (identifier, mask) that let these identifiers through and no other.

    >>> [(hex(f["can_id"]), hex(f["can_mask"])) for f in filters(derived(nodes=3).sensors)]
    [('0x100', '0x7e0'), ('0x120', '0x7f0')]
    """
    from ipaddress import IPv4Address, collapse_addresses, summarize_address_range  # 2 ms that few links need

    # An aligned block of 2^q numbers is what an IP network is.
    owns = [summarize_address_range(IPv4Address(own[0]), IPv4Address(own[-1])) for own in accepted]
    blocks = collapse_addresses(chain.from_iterable(owns))
    return [
        {"can_id": int(block.network_address), "can_mask": LARGEST & int(block.netmask), "extended": False} for block in blocks
    ]


def identifiers_of(uri: str, options: dict[str, str], fd: bool) -> Identifiers:
    """Return the identifiers that the options ``base``, ``nodes``, ``ids`` and ``control`` of a URI say, and take these out.

    Args:
        uri: for messages.
        options: of the URI.
        fd: CAN FD or classic frames.

    Raises:
        TransportError: an option that says none, or identifiers with two owners.

    >>> identifiers_of("can:hil:rig0", {"ids": "0x201,0x210-0x211"}, True).sensors
    (range(513, 514), range(528, 530))
    """
    base = base_of(uri, options)
    options.pop("base", None)
    nodes, ids, control = options.pop("nodes", ""), options.pop("ids", ""), options.pop("control", "")
    try:
        if nodes and (ids or not re.fullmatch("[0-9]{1,3}", nodes)):
            raise FieldError("nodes", f"{nodes!r:.20}, expected a number, and no ids=")
        sensors = [read_range(text) for text in ids.split(",")] if ids else derived(base, fd, int(nodes or "1")).sensors
        return Identifiers(sensors=tuple(sensors), control=read_range(control) if control else derived(base, fd).control)
    except FieldError as error:
        raise TransportError(f"link {uri!r}: {error}") from error


def base_of(uri: str, options: Mapping[str, str]) -> int:
    """Return the base that the options of a CAN link's URI say, 0x100 by default.

    Raises:
        TransportError: no multiple of 0x100.
    """
    try:
        base = int(options.get("base", str(BASE)), 0)
    except ValueError:
        base = -1
    if base not in BASES:
        raise TransportError(f"link {uri!r}: base: expected a multiple of 0x100 from 0 to 0x700, as in base=0x200")
    return base
