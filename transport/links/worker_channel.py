"""A link for each of several processes that test at once, from one URI."""

from __future__ import annotations

from typing import Final
from urllib.parse import urlencode

from transport.links.can_identifiers import BASE
from transport.links.link import TransportError, split_uri

_BASES: Final = range(0, 0x800, 0x100)


def worker_channel(uri: str, number: int) -> str:
    """Return the link of one of several workers: a channel, a range of identifiers or a port of its own.

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
        try:
            first = int(options.get("base", str(BASE)), 0)
        except ValueError:
            return uri  # opening it says what is wrong
        base = (first + 0x100 * number) % 0x800
        if number >= len(_BASES):
            raise TransportError(f"link {uri!r}: one bus has identifiers for {len(_BASES)} workers; start fewer")
        options["base"] = f"{base:#x}"
    elif scheme == "zenoh" and address.startswith(("tcp/", "tls/", "udp/", "ws/")):
        host, _, port = address.rpartition(":")
        if port.isdecimal():
            address = f"{host}:{int(port) + number}"
    elif scheme == "zenoh" and not address:
        options["name"] = f"{options.get('name', 'rig0')}-{number}"
    elif scheme == "zenoh":
        address += f"-{number}"
    return f"{scheme}:{address}" + (f"?{urlencode(options, safe=':/,')}" if options else "")
