"""What a link is: two ends, the rig's and the controller's, that hand over whole packets or lose them, and never raise.

One URI names a link: ``can:hil:rig0``, ``can:socketcan:vcan0?fd=0``, ``zenoh:tcp/127.0.0.1:7447``. The word before the
first colon is the scheme, a plug-in found in the entry point group ``hil.links``: a function ``(uri, role) -> Link``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from types import TracebackType
from typing import TYPE_CHECKING, Final, Literal, Protocol, Self, runtime_checkable
from urllib.parse import parse_qsl

from msgspec import Struct

if TYPE_CHECKING:
    from transport.can_bus_model.disturbances import BusFault
    from transport.can_bus_model.node import State

Role = Literal["rig", "controller"]

LOOK_S: Final = 0.02
"""How long a call that only looks may pass over frames, s."""


class TransportError(Exception):
    """A link that cannot be opened or used; the message names the link, what is wrong and what helps."""


class LinkCounters(Struct):
    """What happened on one end of a link since it was opened.

    Attributes:
        sent: packets handed to the medium.
        received: packets handed to the owner.
        dropped: packets that this end could not hand over or hold: queue full (also those of all listeners, where the medium
            says so), no such peer, link closed or down.
        malformed: frames that belong to this link but are no packet: remote frames, fragments out of order.
        errors: error frames and faults of the medium (interface down, buffer full).
        refused: packets that are not authentic (forged, replayed, without a code), and peers of another name than the one
            that the link admits; in a rig's process over zenoh also what the access-control list denies, and failed logins.
        foreign: frames of other identifiers that this end passed over.
        turned_away: how often a newcomer found no free file descriptor here, or too many others, and had to wait (can:hil).
        unopened: connections to a rig's process over TCP that are no session of zenoh: they say nothing, or nonsense.
    """

    sent: int = 0
    received: int = 0
    dropped: int = 0
    malformed: int = 0
    errors: int = 0
    refused: int = 0
    foreign: int = 0
    turned_away: int = 0
    unopened: int = 0


@runtime_checkable
class Link(Protocol):
    """One end of a link. The rig receives control packets only, the controller sensor packets only.

    Attributes:
        uri: the URI it was opened with.
        counters: what happened so far.
    """

    @property
    def uri(self) -> str: ...

    @property
    def counters(self) -> LinkCounters: ...

    def send(self, packet: bytes) -> None:
        """Send one packet; never raises and never waits longer than 2 ms. What cannot be sent is dropped and counted.

        Args:
            packet: as made by `encode_sensor` or `encode_control`.
        """

    def receive(self, timeout_s: float) -> bytes | None:
        """Return the next packet, or None when none came in time; never raises.

        May return None early when something came that is no packet of this link (an error frame, say). Bytes are
        handed on as they came: `transport.packets.decode` judges them.

        Args:
            timeout_s: how long to wait, s; 0 or less only looks. However many frames are passed over, the call ends then, a
                look within `LOOK_S`.
        """

    def close(self) -> None:
        """Let go of the medium; may be called twice. Afterwards `send` drops and `receive` returns None."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


@runtime_checkable
class Discoverable(Protocol):
    """A link on which others can ask what runs on it."""

    def announce(self, about: Mapping[str, object]) -> None:
        """Answer questions of what runs here.

        Args:
            about: plain values.
        """


@runtime_checkable
class OneOfARole(Protocol):
    """A link that learns while it is open that another end has its role."""

    def check_alone(self) -> None:
        """Say so.

        Raises:
            TransportError: who has the role.
        """


class BusStatus(Struct, frozen=True):
    """An error state that a node on a CAN bus has reached.

    Attributes:
        state: as `transport.can_bus_model.node.State` has it.
        tec, rec: its transmit and receive error counter.
    """

    state: State
    tec: int
    rec: int


@runtime_checkable
class OnBus(Protocol):
    """A link over a CAN bus whose bits can be disturbed, and whose nodes can be off it."""

    def disturb(self, faults: Sequence[BusFault], seed: int) -> None:
        """Say what is wrong with the bus when, in place of what was said before.

        Args:
            faults: their instants in CLOCK_MONOTONIC, ns; `off`: 0 for this end, 1 for the other one.
            seed: of the bits that are disturbed at random.

        Raises:
            TransportError: the bus takes no time.
        """

    def statuses(self) -> list[BusStatus]:
        """Return the error states that this end has reached since the last call, in order; of very many the last ones."""


class Closing:
    """`with` for what has `close`."""

    __slots__ = ()

    def close(self) -> None:
        """Let go of it; may be called twice."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()


FORMS: Final = {
    "can": ("[^:]+:.+", "no channel, expected can:<interface>:<channel>, as in can:hil:rig0"),
    "zenoh": ("([^/:]+/.+)?", "no endpoint, expected <protocol>/<address>, as in tcp/127.0.0.1:7447, or nothing"),
}


def split_uri(uri: str) -> tuple[str, str, dict[str, str]]:
    """Return scheme, address and options of a link URI.

    Raises:
        TransportError: an address of another form than the scheme's, an option without a value, or named twice.

    >>> split_uri("can:socketcan:vcan0?fd=0&base=0x200")
    ('can', 'socketcan:vcan0', {'fd': '0', 'base': '0x200'})
    """
    scheme, _, rest = uri.partition(":")
    address, _, query = rest.partition("?")
    try:
        pairs = parse_qsl(query, keep_blank_values=True, strict_parsing=bool(query))
    except ValueError as error:
        raise TransportError(f"link {uri!r}: options {query!r} are not name=value, joined by &") from error
    form, expected = FORMS.get(scheme, (None, ""))
    if form is not None and not re.fullmatch(form, address):
        raise TransportError(f"link {uri!r}: {expected}")
    options = dict(pairs)
    if len(options) != len(pairs):
        raise TransportError(f"link {uri!r}: an option is named twice in {query!r}")
    return scheme, address, options


def key_file(uri: str) -> str | None:
    """Return the file that a URI names by ``auth=``: its key authenticates every packet. None without one.

    Raises:
        TransportError: no file is named.

    >>> key_file("can:hil:rig0?auth=keys/frames.key"), key_file("can:hil:rig0")
    ('keys/frames.key', None)
    """
    said = split_uri(uri)[2].get("auth")
    if said == "":
        raise TransportError(f"link {uri!r}: auth: expected the file of a key, as `hil keys new DIR` makes one")
    return said
