"""Whether a certificate of this end can be accepted by the other: in time, of its authority, called as it must be, not revoked.

zenoh reads no list of revoked certificates, and shows of a peer's certificate its common name alone. So a *name* is revoked:
its end gets another name and a certificate for it, and zenoh's access-control list, which names one peer, keeps the old one out.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Final

from transport.links import TransportError
from transport.links.private_directory import read_bounded

if TYPE_CHECKING:
    from cryptography.x509 import Certificate


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
    if not os.path.lexists(path):
        return frozenset()
    data = read_bounded(path, "a list of revoked names", _MOST_BYTES)
    try:
        text = data.decode()
    except UnicodeDecodeError as error:
        raise TransportError(f"{path}: is no text, not a list of revoked names") from error
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


_REMEDY: Final = "`hil keys renew DIR` makes new ones"


def check_certificate(ca: str, cert: str, name: str, now: datetime | None = None) -> datetime:
    """Refuse a certificate that the other end would refuse; return when it ends.

    zenoh reports to neither end why: the one that connects tries for ever.

    Args:
        ca: file of the authority's certificates, PEM.
        cert: file of this end's certificate, PEM, which those that lead to the authority may follow.
        name: what this end must be called.
        now: instead of the clock's.

    Raises:
        TransportError: expired, not yet valid, of another authority, of another or a revoked name, or no certificate.
    """
    with cryptography_needed():
        from cryptography import x509  # 40 ms that no other link needs

    chains = []
    for path in (ca, cert):
        data = read_bounded(path, "a certificate in PEM", _MOST_BYTES)
        try:
            chains.append(x509.load_pem_x509_certificates(data))
        except ValueError as error:
            raise TransportError(f"{path}: is no certificate in PEM: {error}") from error
    (roots, (own, *between)), now = chains, now or datetime.now(UTC)
    for path, each in ((cert, own), *((cert, one) for one in between), *((ca, root) for root in roots[:1])):
        if now > each.not_valid_after_utc:
            raise TransportError(f"{path}: the certificate expired on {each.not_valid_after_utc:%Y-%m-%d %H:%M} UTC; {_REMEDY}")
        if now < each.not_valid_before_utc:
            begins = f"{each.not_valid_before_utc:%Y-%m-%d %H:%M} UTC"
            raise TransportError(f"{path}: the certificate is not yet valid, but from {begins}; is this machine's clock right?")
    if not any(_issued(own, issuer) for issuer in (*between, *roots)):
        raise TransportError(f"{cert}: is a certificate of another authority than {ca}")
    called = [str(each.value) for each in own.subject.get_attributes_for_oid(x509.NameOID.COMMON_NAME)]
    if name not in called:
        raise TransportError(f"{cert}: is called {', '.join(called) or 'nothing'}, the other end lets in only {name}")
    refuse_revoked(ca, *called)
    return min(each.not_valid_after_utc for each in (own, *between))


def _issued(certificate: Certificate, issuer: Certificate) -> bool:
    from cryptography.exceptions import InvalidSignature

    try:
        certificate.verify_directly_issued_by(issuer)
    except (ValueError, TypeError, InvalidSignature):
        return False
    return True


INSTALL = "pip install 'hilrig[keys]'"


@contextmanager
def cryptography_needed() -> Iterator[None]:
    """Say how to install the package, where what is imported within lacks it.

    Raises:
        TransportError: it is not installed.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] != "cryptography":
            raise
        message = f"keys, certificates and signatures need cryptography, which is not installed: {INSTALL}"
        raise TransportError(message) from None
