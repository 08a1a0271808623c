"""How a link is opened: the plug-in that a URI names, and around it the codes that the URI asks for.

A link of any scheme carries packets with a code or without; the plug-in knows nothing of it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, Never, get_args
from urllib.parse import urlencode

from transport.errors import nearest
from transport.installed import Point, points
from transport.links import FORMS, Link, LinkCounters, Role, TransportError, key_file, split_uri
from transport.links.can_identifiers import BASES, base_of


def _for_the_plugin(uri: str) -> str:
    """Return the URI that the plug-in reads: every link carries packets with a code or without."""
    address, _, query = uri.partition("?")
    kept = "&".join(option for option in query.split("&") if option.partition("=")[0] != "auth")
    return f"{address}?{kept}" if kept else address


def is_foreign(uri: str) -> bool:
    """Return whether the plug-in that a URI names is not of this package; see `find_link`."""
    return not find_link(uri).value.startswith("transport.")


def find_link(uri: str) -> Point:
    """Return the plug-in that a URI names; nothing is opened or imported.

    Raises:
        TransportError: no such scheme, or a URI of another form than the scheme's.

    >>> find_link("cann:hil:rig0")
    Traceback (most recent call last):
    transport.links.TransportError: link 'cann:hil:rig0': no link is called 'cann', did you mean 'can:hil:rig0'?
    """
    found = {plugin.name: plugin for plugin in points("hil.links") if plugin.group == "hil.links"}
    scheme, colon, rest = uri.partition(":")
    if not colon or not scheme:
        raise TransportError(f"link {uri!r}: no scheme, expected one of {', '.join(sorted(found))}, as in can:hil:rig0")
    if scheme not in found:
        near = nearest(scheme, found)
        own = "python-can's are can:INTERFACE:CHANNEL, such as can:udp_multicast:239.74.163.2; an own one is an entry point"
        hint = f"did you mean '{near}:{rest}'?" if near else f"expected one of {', '.join(sorted(found))}; {own}"
        raise TransportError(f"link {uri!r}: no link is called {scheme!r}, {hint}")
    if scheme in FORMS:
        key_file(uri)
    return found[scheme]


def open_link(uri: str, role: Role, period_s: float = 0.0) -> Link:
    """Open one end of the link that a URI names.

    Args:
        uri: scheme, colon, address, as in ``can:hil:rig0``.
        role: which end.
        period_s: of the loop, s; a controller with a key takes another session after three periods of silence, 1 s at least.

    Returns:
        The open end; use it with ``with``.

    Raises:
        TransportError: the URI is not understood, or the medium cannot be had; the message says what to do.
    """
    if role not in get_args(Role):
        raise TransportError(f"link {uri!r}: role {role!r}, expected 'rig' or 'controller'")
    plugin = find_link(uri)
    keyed = key_file(uri) if "auth=" in uri else None
    around = None if keyed is None else _codes(keyed, role, uri, period_s)
    uri = _for_the_plugin(uri) if keyed is not None else uri
    try:
        link: Link = plugin.load()(uri, role)
        check_is_link(link)
        return link if around is None else around(link)
    except (TransportError, KeyboardInterrupt):
        raise
    except AssertionError as error:
        raise TransportError(f"link {uri!r}: plug-in {plugin}: check_link: {error}") from None
    except BaseException as error:  # whatever a plug-in raises, where it is opened or asked what it has
        from traceback import extract_tb  # of a fault alone

        last = extract_tb(error.__traceback__)[-1]
        where = "" if last.filename.startswith("<") else f" ({last.filename}, line {last.lineno})"  # <frozen importlib>
        raise TransportError(f"link {uri!r}: plug-in {plugin}: {type(error).__name__}: {error}{where}") from error


def open_within(uri: str, role: Role) -> Never:
    """Refuse ``local:`` and ``memory:``: the controller runs in the rig's own process, and no end is left to open by a URI.

    Raises:
        TransportError: always; it says what to use instead.
    """
    raise TransportError(
        f"link {uri!r}: the controller runs in the rig's own process, and no {role} can be opened by name; "
        "use can:hil:rig0 between processes"
    )


LINK: Final = {
    "uri": "the URI it was opened with",
    "counters": "a transport.LinkCounters",
    "send": "send(packet) never raises, and waits 2 ms at most",
    "receive": "receive(timeout_s) gives bytes, or None",
    "close": "close() may be called twice",
    "__enter__": "for `with`",
    "__exit__": "for `with`",
}


def check_is_link(made: object) -> None:
    """Check that an object has what a link has; `transport.check_link` holds it to what that does.

    Raises:
        AssertionError: with each attribute that is missing.
    """
    missing = [f"`{name}` ({meaning})" for name, meaning in LINK.items() if not hasattr(made, name)]
    if missing:
        raise AssertionError(f"{type(made).__name__}, what the plug-in returned, needs {', '.join(missing)}")
    if not isinstance(counters := made.counters, LinkCounters):  # type: ignore[attr-defined]
        raise AssertionError(f"{type(made).__name__}.counters: a {type(counters).__name__}, expected {LINK['counters']}")


def _codes(key: str, role: Role, uri: str, period_s: float) -> Callable[[Link], Link]:
    """Return the function that adds the codes of a key to a link; a link without a key costs nothing more."""
    from transport.links.authentication import SILENCE_S, AuthenticatedLink, cmac, read_key

    try:
        code = cmac(read_key(key))
    except TransportError as error:
        raise TransportError(f"link {uri!r}: {error}") from error
    return lambda link: AuthenticatedLink(link, role, code, silence_s=max(SILENCE_S, 3 * period_s))


def worker_channel(uri: str, number: int) -> str:
    """Return the link of one of several workers: a channel, a range of identifiers or a port of its own.

    The workers test at once, from one URI.

    Args:
        uri: of the link that they would share.
        number: of the worker, from 0.

    Raises:
        TransportError: a CAN bus with more than eight workers, for its identifiers are used up, or a URI of another form.

    >>> worker_channel("can:hil:rig0?fd=0", 2), worker_channel("can:socketcan:vcan0", 1)
    ('can:hil:rig0-2?fd=0', 'can:socketcan:vcan0?base=0x200')
    >>> worker_channel("zenoh:tcp/127.0.0.1:7447", 1)
    'zenoh:tcp/127.0.0.1:7448'
    >>> worker_channel("local:", 3), worker_channel("zenoh:", 1)
    ('local:', 'zenoh:?name=rig0-1')
    """
    scheme, address, options = split_uri(uri)
    if scheme == "can" and address.startswith("hil:"):
        address += f"-{number}"
    elif scheme == "can":
        if number >= len(BASES):
            raise TransportError(f"link {uri!r}: one bus has identifiers for {len(BASES)} workers; start fewer")
        options["base"] = f"{(base_of(uri, options) + 0x100 * number) % 0x800:#x}"
    elif scheme == "zenoh" and address.startswith(("tcp/", "tls/", "udp/", "ws/")):
        host, _, port = address.rpartition(":")
        if port.isdecimal():
            address = f"{host}:{int(port) + number}"
    elif scheme == "zenoh" and not address:
        options["name"] = f"{options.get('name', 'rig0')}-{number}"
    elif scheme == "zenoh":
        address += f"-{number}"
    return f"{scheme}:{address}" + (f"?{urlencode(options, safe=':/,')}" if options else "")
