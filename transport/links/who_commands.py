"""Who could command the rig at the other end of a link, in one line, by the link's URI alone."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from transport.links.link import key_file, split_uri


def who_commands(uri: str) -> str:
    """Return who could make the rig on a link apply an input, root of this machine aside.

    What is hidden from others by this machine (a user's own directory, the loopback) and what is proved by a key or a certificate
    are told apart. Of a link of somebody else's nothing is known here, and that is said.

    Args:
        uri: of the link.

    Raises:
        TransportError: a URI of another form than its scheme's.

    >>> who_commands("memory:")
    'nobody else: one process'
    >>> who_commands("can:socketcan:can0")
    'anyone on the CAN bus can0'
    >>> who_commands("can:socketcan:can0?auth=keys/frames.key")
    'holders of the key keys/frames.key'
    >>> who_commands("zenoh:tls/10.0.0.1:7447?keys=keys")
    'holders of a certificate of keys/ca.pem that is called controller'
    """
    scheme, address, options = split_uri(uri)
    keyed = key_file(uri)
    if keyed is not None:
        return f"holders of the key {keyed}"
    if scheme in ("memory", "local"):
        return "nobody else: one process"
    if scheme == "can":
        return _on_can(*address.partition(":")[::2], hops=options.get("hop_limit", "0"))
    if scheme == "zenoh":
        return _on_zenoh(address, options)
    return f"unknown: the link {scheme!r} does not say whom it lets in"


def _on_can(interface: str, channel: str, hops: str) -> str:
    if interface == "hil":
        return "any process of this user"
    if interface == "virtual":
        return "nobody else: one process"
    if interface == "udp_multicast":
        return "any process on this machine" if hops == "0" else "anyone on the local network"
    return f"anyone on the CAN bus {channel}"


def _on_zenoh(endpoint: str, options: dict[str, str]) -> str:
    protocol, _, address = endpoint.partition("/")
    if protocol == "tls":
        authority = options.get("ca") or f"{options.get('keys', '')}/ca.pem"
        return f"holders of a certificate of {authority} that is called {options.get('controller', 'controller')}"
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
