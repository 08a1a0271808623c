"""Who could command the rig at the other end of a link, in one line: what `transport.links.traits` says of our schemes.

What is hidden from others by this machine (a user's own directory, the loopback) and what is proved by a key or a certificate
are told apart; root of this machine is left aside.
"""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import Final

NO_ONE_ELSE: Final = "nobody else: one process"


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


def on_zenoh_certificates(authority: str, name: str) -> str:
    """Return who could command a rig over zenoh where both ends show certificates."""
    return f"holders of a certificate of {authority} that is called {name}"


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
