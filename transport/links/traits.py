"""What a link says of itself by its URI alone, before anything is opened, and who could command a rig over it.

Our schemes say it here. A plug-in says it where what opens its links, the object of its entry point, also has `traits`.

What is hidden from others by this machine (a user's own directory, the loopback) and what is proved by a key or a certificate
are distinguished; root of this machine is left aside.

No other room reads the text of a URI.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final, Literal, Protocol, runtime_checkable

from msgspec import Struct
from msgspec.structs import replace

from transport.links import TransportError, key_file, split_uri
from transport.links.can_identifiers import BASE, MESSAGES, Identifiers, base_of, identifiers_of

NO_ONE_ELSE: Final = "no other process: the controller runs in the rig's own"


def on_can(interface: str, channel: str, hops: str) -> str:
    """Return who could command a rig over a CAN link.

    Args:
        interface: of python-can.
        channel: of the interface.
        hops: how far a multicast goes.
    """
    if interface == "hil":
        return "any process of this user"
    if interface == "virtual":
        return NO_ONE_ELSE
    if interface == "udp_multicast":
        return "any process on this machine" if hops == "0" else "anyone on the local network"
    return f"anyone on the CAN bus {channel}"


def on_zenoh(endpoint: str, options: dict[str, str]) -> str:
    """Return who could command a rig over zenoh without certificates.

    Args:
        endpoint: of the rig, protocol and address.
        options: of the URI.
    """
    protocol, _, address = endpoint.partition("/")
    if not endpoint:
        return "any process of this user"
    if "users" in options:
        return f"who knows the password of controller in {options['users']}, or reads it on its way"
    if protocol == "unixsock-stream":
        return _at_socket(Path(address).parent)
    return f"anyone who reaches {address}" if options.get("lan") == "1" else "any process on this machine"


def _at_socket(folder: Path) -> str:
    try:
        status = folder.stat()
    except OSError:
        return f"any process that may write {folder}"
    private = status.st_uid == os.geteuid() and not stat.S_IMODE(status.st_mode) & 0o077
    return "any process of this user" if private else f"any process that may write in {folder}"


LinkTable = Literal["tls", "login", "messages"]
"""Tables of an experiment's `[links]` that not every link takes."""


class CanFraming(Struct, frozen=True, kw_only=True):
    """How packets are cut into CAN frames.

    Args:
        base: first identifier, a multiple of 0x100.
        fd: CAN FD, or classic frames.
        names_nodes: whether the URI itself says the identifiers of the nodes.
    """

    base: int = BASE
    fd: bool = True
    names_nodes: bool = False

    @property
    def frame_bytes(self) -> int:
        """Bytes that one frame carries."""
        return 64 if self.fd else 8


class LinkTraits(Struct, frozen=True, kw_only=True):
    """What a link is.

    Args:
        commanders: who could make the rig apply an input, in one line.
        can: how packets become CAN frames with identifiers; None for a link of whole datagrams.
        one_process: whether both ends live in one process.
        in_process: whether the rig's process runs the controller itself, so that there is no way between them that takes time.
        timed: whether its frames take the time of a CAN bus, whose bits faults can disturb.
        own_threads: whether packets pass through threads of the link's own at each end.
        takes: tables that its URI has options for, beside the key of `auth=`, which every link takes.
        keyed: whether every packet has a message authentication code.
        names_certificates: whether the URI itself says where certificates stand.
        certificates: by which files both ends know each other; None where they show no certificates.
    """

    commanders: str
    can: CanFraming | None = None
    one_process: bool = False
    in_process: bool = False
    timed: bool = False
    own_threads: bool = False
    takes: frozenset[LinkTable] = frozenset()
    keyed: bool = False
    names_certificates: bool = False
    certificates: Certificates | None = None


class Certificates(Struct, frozen=True, kw_only=True):
    """The files by which both ends of a link know each other.

    Args:
        ca: certificate of the authority.
        own: role to the certificate of that end.
        names: role to the name that its certificate must have.
    """

    ca: str
    own: Mapping[str, str]
    names: Mapping[str, str]


@runtime_checkable
class SaysTraits(Protocol):
    """What opens links and says what they are."""

    def traits(self, uri: str) -> LinkTraits:
        """Return what the link of a URI is; it opens nothing.

        Raises:
            TransportError: a URI of another form than the scheme's.
        """


def traits_of(uri: str) -> LinkTraits:
    """Return what the link of a URI is; nothing is opened.

    Args:
        uri: scheme, colon, address.

    Raises:
        TransportError: no such scheme, or a URI of another form than the scheme's.

    >>> traits_of("can:hil:rig0?base=0x200&fd=0").can
    CanFraming(base=512, fd=False, names_nodes=False)
    >>> traits_of("zenoh:").can is None, traits_of("local:").in_process
    (True, True)
    """
    ours = _OURS.get(uri.partition(":")[0]) if ":" in uri else None
    found = _foreign(uri) if ours is None else ours(uri)
    keyed = key_file(uri)
    if keyed is not None:
        return replace(found, keyed=True, commanders=f"holders of the key {keyed}")
    open_to_others = ours is not None and found.certificates is None and not found.one_process
    return replace(found, commanders=f"{found.commanders} (no key set)") if open_to_others else found


def scheme_of(uri: str) -> str:
    """Return the scheme of a URI, without its colon."""
    return uri.partition(":")[0]


def address_of(uri: str) -> str:
    """Return what stands between the scheme of a URI and its options.

    Raises:
        TransportError: options that are not name=value.
    """
    return split_uri(uri)[1]


def without_options(uri: str) -> str:
    """Return a URI without its options, as a name."""
    return uri.partition("?")[0]


def in_short(uri: str) -> str:
    """Return a URI as a line has room for it: of messages of the controller's own their database alone.

    >>> in_short("can:hil:bench?fd=0&dbc=drive.dbc&outputs=Encoder.Angle&inputs=Drive.U"), in_short("can:hil:rig0?fd=0")
    ('can:hil:bench?fd=0&dbc=drive.dbc', 'can:hil:rig0?fd=0')
    """
    address, _, query = uri.partition("?")
    kept = [option for option in query.split("&") if option.partition("=")[0] not in MESSAGES[1:]]
    return "?".join(filter(None, (address, "&".join(kept))))


def identifiers_on(uri: str) -> Identifiers:
    """Return the identifiers of the packets on a CAN link, as its URI says them, or those of one node.

    Raises:
        TransportError: options that say none.
    """
    options = split_uri(uri)[2]
    return identifiers_of(uri, options, options.get("fd", "1") == "1")


def with_options(uri: str, options: Mapping[str, str]) -> str:
    """Return a URI with options beside its own; what it says itself is kept.

    >>> with_options("can:hil:rig0?fd=0", {"fd": "1", "nodes": "2"})
    'can:hil:rig0?fd=0&nodes=2'
    """
    address, _, query = uri.partition("?")
    said = {option.partition("=")[0] for option in query.split("&")}
    more = [f"{name}={value}" for name, value in options.items() if name not in said]
    return "?".join(filter(None, (address, "&".join(filter(None, (query, *more))))))


def framing_options(uri: str) -> dict[str, str]:
    """Return the options that say which frames a CAN link has, and on which identifiers.

    >>> framing_options("can:hil:rig0?fd=0&hop_limit=1&base=0x200")
    {'fd': '0', 'base': '0x200'}
    """
    options = split_uri(uri)[2]
    return {name: options[name] for name in ("fd", "base", "nodes", "ids", "control") if name in options}


def _can(uri: str) -> LinkTraits:
    _, address, options = split_uri(uri)
    framing = CanFraming(
        base=base_of(uri, options), fd=options.get("fd", "1") == "1", names_nodes=bool(options.keys() & {"nodes", "ids"})
    )  # fmt: skip
    interface, _, channel = address.partition(":")
    commanders = on_can(interface, channel, hops=options.get("hop_limit", "0"))
    timed = interface == "hil" and options.get("timed") in ("1", "true")  # a thread hands out what has got through
    if "dbc" in options and "auth" in options:
        raise TransportError(f"link {uri!r}: auth: messages of the controller's own (dbc=) have no room for a code")
    return LinkTraits(
        can=None if "dbc" in options else framing, commanders=commanders, timed=timed, own_threads=timed,
        one_process=interface == "virtual", takes=frozenset(("messages",)),
    )  # fmt: skip


def _zenoh(uri: str) -> LinkTraits:
    _, endpoint, options = split_uri(uri)
    shown: Certificates | None = None
    if endpoint.startswith("tls/"):
        folder, names = options.get("keys", ""), {role: options.get(role, role) for role in ("rig", "controller")}
        own = {role: options.get("cert", f"{folder}/{name}.pem").replace("{role}", role) for role, name in names.items()}
        shown = Certificates(ca=options.get("ca") or f"{folder}/ca.pem", own=own, names=names)
        commanders = f"holders of a certificate of {shown.ca} that is called {names['controller']}"
    else:
        commanders = on_zenoh(endpoint, options)
    return LinkTraits(
        commanders=commanders, own_threads=True, takes=frozenset(("tls", "login")), certificates=shown,
        names_certificates=bool(options.keys() & {"keys", "ca", "cert", "key"}),
    )  # fmt: skip


def _in_process(uri: str) -> LinkTraits:
    return LinkTraits(commanders=NO_ONE_ELSE, one_process=True, in_process=scheme_of(uri) == "local")


_OURS: Final[Mapping[str, Callable[[str], LinkTraits]]] = {
    "can": _can, "local": _in_process, "memory": _in_process, "zenoh": _zenoh,
}  # fmt: skip


def _foreign(uri: str) -> LinkTraits:
    from transport.links.opening import find_link

    plugin = find_link(uri)
    unknown = LinkTraits(commanders=f"unknown: the link {plugin.name!r} does not say whom it lets in")
    try:
        opener = plugin.load()
    except (ImportError, AttributeError):
        return unknown  # opening it says so
    if not isinstance(opener, SaysTraits):
        return unknown
    said = opener.traits(uri)
    if not isinstance(said, LinkTraits):
        raise TransportError(f"link {uri!r}: plug-in {plugin.value}: traits gave {said!r:.60}, expected transport.LinkTraits")
    return said
