"""What a link is: two ends, the rig's and the controller's, that hand over whole packets or lose them, and never raise.

One URI names a link: ``can:hil:rig0``, ``can:socketcan:vcan0?fd=0``, ``zenoh:tcp/127.0.0.1:7447``. The word before the
first colon is the scheme, a plug-in found in the entry point group ``hil.links``: a function ``(uri, role) -> Link``.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from types import TracebackType
from typing import TYPE_CHECKING, Final, Literal, Protocol, Self, get_args, runtime_checkable
from urllib.parse import parse_qsl

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

Role = Literal["rig", "controller"]


class TransportError(Exception):
    """A link that cannot be had; the message names the link, what is wrong and how to mend it."""


@dataclass(slots=True)
class LinkCounters:
    """What happened on one end of a link since it was opened.

    Attributes:
        sent: packets handed to the medium.
        received: packets handed to the owner.
        dropped: packets that this end could not hand over or hold: queue full (also a listener's, where the medium says so),
            no such peer, link closed or down.
        malformed: frames that belong to this link but are no packet: remote frames, fragments out of order.
        errors: error frames and faults of the medium (interface down, buffer full).
        refused: packets that are not authentic (forged, replayed, without a code), and peers of another name than the one
            whom the link lets speak.
        turned_away: how often a newcomer found no free file descriptor here and had to wait (can:hil).
    """

    sent: int = 0
    received: int = 0
    dropped: int = 0
    malformed: int = 0
    errors: int = 0
    refused: int = 0
    turned_away: int = 0


@runtime_checkable
class Link(Protocol):
    """One end of a link. The rig hears control packets only, the controller sensor packets only.

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
        ...

    def receive(self, timeout_s: float) -> bytes | None:
        """Return the next packet, or None when none came in time; never raises.

        May return None early when something came that is no packet of this link (an error frame, say). Bytes are
        handed on as they came: `transport.packets.decode` judges them.

        Args:
            timeout_s: how long to wait, s; 0 or less only looks.
        """
        ...

    def close(self) -> None:
        """Let go of the medium; may be called twice. Afterwards `send` drops and `receive` returns None."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


class Closing:
    """`with` for what has `close`."""

    __slots__ = ()

    def close(self) -> None:
        """Let go of it; may be called twice."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


_FORMS: Final = {
    "can": (re.compile("[^:]+:.+"), "no channel, expected can:<interface>:<channel>, as in can:hil:rig0"),
    "zenoh": (re.compile("([^/:]+/.+)?"), "no endpoint, expected <protocol>/<address>, as in tcp/127.0.0.1:7447, or nothing"),
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
    form, expected = _FORMS.get(scheme, (None, ""))
    if form is not None and not form.fullmatch(address):
        raise TransportError(f"link {uri!r}: {expected}")
    options = dict(pairs)
    if len(options) != len(pairs):
        raise TransportError(f"link {uri!r}: an option is named twice in {query!r}")
    return scheme, address, options


def wire_version(uri: str) -> Literal[1, 2]:
    """Return the version of the wire format that a URI asks for by ``version=``, 2 by default.

    Raises:
        TransportError: another version than 1 or 2.

    >>> wire_version("can:hil:rig0"), wire_version("can:hil:rig0?version=1")
    (2, 1)
    """
    said = split_uri(uri)[2].get("version", "2")
    if said not in ("1", "2"):
        raise TransportError(f"link {uri!r}: version={said}, expected 1 or 2 (of the wire format)")
    return 1 if said == "1" else 2


def key_file(uri: str) -> str | None:
    """Return the file that a URI names by ``auth=``: its key authenticates every packet. None without one.

    Raises:
        TransportError: together with wire version 1, which has no room for a code.

    >>> key_file("can:hil:rig0?auth=keys/frames.key"), key_file("can:hil:rig0")
    ('keys/frames.key', None)
    """
    said = split_uri(uri)[2].get("auth")
    if said is not None and wire_version(uri) == 1:
        raise TransportError(f"link {uri!r}: wire version 1 has no room for a code: auth= needs version 2")
    if said == "":
        raise TransportError(f"link {uri!r}: auth: expected the file of a key, as `hil keys new DIR` makes one")
    return said


def _for_the_plugin(uri: str) -> str:
    """Return the URI that the plug-in reads: every link carries the packets of either version, with a code or without."""
    address, _, query = uri.partition("?")
    kept = "&".join(option for option in query.split("&") if option.partition("=")[0] not in ("version", "auth"))
    return f"{address}?{kept}" if kept else address


def find_link(uri: str) -> EntryPoint:
    """Return the plug-in that a URI names; nothing is opened or imported.

    Raises:
        TransportError: no such scheme, or a URI of another form than the scheme's.

    >>> find_link("cann:hil:rig0")
    Traceback (most recent call last):
    transport.links.link.TransportError: link 'cann:hil:rig0': no link is called 'cann', did you mean 'can:hil:rig0'?
    """
    from importlib.metadata import entry_points  # 20 ms that importing the package does not need

    found = {plugin.name: plugin for plugin in entry_points(group="hil.links")}
    scheme, colon, rest = uri.partition(":")
    if not colon or not scheme:
        raise TransportError(f"link {uri!r}: no scheme, expected one of {', '.join(sorted(found))}, as in can:hil:rig0")
    if scheme not in found:
        from difflib import get_close_matches

        near = get_close_matches(scheme, found, n=1)
        hint = f"did you mean '{near[0]}:{rest}'?" if near else f"expected one of {', '.join(sorted(found))}"
        raise TransportError(f"link {uri!r}: no link is called {scheme!r}, {hint}")
    if scheme in _FORMS:
        key_file(uri)
    return found[scheme]


def open_link(uri: str, role: Role) -> Link:
    """Open one end of the link that a URI names.

    Args:
        uri: scheme, colon, address, as in ``can:hil:rig0``.
        role: which end.

    Returns:
        The open end; use it with ``with``.

    Raises:
        TransportError: the URI is not understood, or the medium cannot be had; the message says what to do.
    """
    if role not in get_args(Role):
        raise TransportError(f"link {uri!r}: role {role!r}, expected 'rig' or 'controller'")
    plugin = find_link(uri)
    keyed = key_file(uri) if "auth=" in uri else None
    code = None
    if keyed is not None:
        from transport.links.authenticated_link import AuthenticatedLink, cmac, read_key  # imports cryptography: only here

        try:
            code = cmac(read_key(keyed))
        except TransportError as error:
            raise TransportError(f"link {uri!r}: {error}") from error
    uri = _for_the_plugin(uri) if "version=" in uri or keyed is not None else uri
    try:
        opener = plugin.load()
    except (ImportError, AttributeError) as error:
        raise TransportError(f"link {uri!r}: plug-in {plugin.value} cannot be loaded: {error}") from error
    link: Link = opener(uri, role)
    return link if code is None else AuthenticatedLink(link, role, code)
