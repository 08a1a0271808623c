"""Names whose certificates are let in no more: a file beside the authority's certificate, read whenever a link opens.

zenoh reads no list of revoked certificates, and shows of a peer's certificate its common name alone. So a *name* is revoked:
its end gets another name and a certificate for it, and zenoh's access-control list, which names one peer, keeps the old one out.
"""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import Final

from transport.links.link import TransportError

FILE: Final = "revoked"
"""Its name; one name a line."""

_MOST_BYTES: Final = 1 << 20


def revoked_names(ca: str | Path) -> frozenset[str]:
    """Return the names of the list beside the certificate of an authority; none where there is no list.

    Args:
        ca: file of the authority's certificate.

    Raises:
        TransportError: the list cannot be read, is no regular file, no text, or too large.
    """
    path = Path(ca).parent / FILE
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except FileNotFoundError:
        return frozenset()
    except OSError as error:
        raise TransportError(f"{path}: the list of revoked names cannot be read: {error.strerror}") from error
    try:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise TransportError(f"{path}: is no regular file, not a list of revoked names")
        data = os.read(descriptor, _MOST_BYTES + 1)
    finally:
        os.close(descriptor)
    try:
        text = data.decode()
    except UnicodeDecodeError as error:
        raise TransportError(f"{path}: is no text, not a list of revoked names") from error
    if len(data) > _MOST_BYTES:
        raise TransportError(f"{path}: more than {_MOST_BYTES} bytes, too many for a list of revoked names")
    return frozenset(filter(None, map(str.strip, text.splitlines())))


def refuse_revoked(ca: str | Path, *names: str) -> None:
    """Refuse names that are on the list.

    Args:
        ca: file of the authority's certificate.
        names: of certificates.

    Raises:
        TransportError: one is revoked, or the list is none.
    """
    gone = sorted(revoked_names(ca) & set(names))
    if gone:
        raise TransportError(
            f"{Path(ca).parent / FILE}: the name {gone[0]} is revoked; `hil keys issue DIR NAME` makes a certificate of another "
            "name, which the link takes with ?rig=NAME or ?controller=NAME"
        )
