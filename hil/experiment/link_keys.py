"""Keys and certificates of a link, as tables of an experiment file: each stands for options of the link's URI."""

from __future__ import annotations

from pathlib import Path
from urllib.parse import quote

import msgspec

from transport.links.traits import traits_of, with_options


class Auth(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A message authentication code in every packet.

    Args:
        key_file: file of the key, mode 0600, as ``hil keys new`` makes it; from where the experiment stands.
    """

    key_file: str


class Tls(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Certificates of both ends, for a link zenoh:tls/HOST:PORT; ``{role}`` in a path is rig or controller.

    Args:
        keys: folder made by ``hil keys new``; stands for the three below.
        ca: certificate of the authority.
        cert: this end's certificate.
        key: its private key, mode 0600.
    """

    keys: str | None = None
    ca: str | None = None
    cert: str | None = None
    key: str | None = None


class Login(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A password for the controller, for a link over zenoh.

    Args:
        users: file of lines NAME:PASSWORD, mode 0600, with one for controller.
    """

    users: str


def secured_uri(uri: str, folder: str, auth: Auth | None, tls: Tls | None, login: Login | None) -> str:
    """Return a link's URI with the options that the tables stand for; what the URI says itself is kept.

    Args:
        uri: of the link.
        folder: where the experiment stands, from which paths count.
        auth, tls, login: the tables.

    >>> secured_uri("can:hil:rig0?fd=0", "/lab", Auth(key_file="frames.key"), None, None)
    'can:hil:rig0?fd=0&auth=/lab/frames.key'
    """
    wanted = {"auth": auth.key_file} if auth else {}
    if tls is not None or login is not None:
        traits = traits_of(uri)
        if tls is not None and "tls" in traits.takes and not traits.names_certificates:
            named = {"keys": tls.keys, "ca": tls.ca, "cert": tls.cert, "key": tls.key}
            wanted |= {name: path for name, path in named.items() if path is not None}
        if login is not None and "login" in traits.takes:
            wanted["users"] = login.users
    return with_options(uri, {name: quote(str(Path(folder) / path), safe="/{}") for name, path in wanted.items()})
