"""Whether a certificate of this end can be accepted by the other: in time, of its authority, called as it must be."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Final

from transport.links.link import TransportError
from transport.links.revoked import refuse_revoked

if TYPE_CHECKING:
    from cryptography.x509 import Certificate

_REMEDY: Final = "`hil keys renew DIR` makes new ones"


def check_certificate(ca: str, cert: str, name: str, now: datetime | None = None) -> datetime:
    """Refuse a certificate that the other end would refuse; return when it ends.

    zenoh tells neither end why: the one that connects tries for ever.

    Args:
        ca: file of the authority's certificates, PEM.
        cert: file of this end's certificate, PEM, which those that lead to the authority may follow.
        name: what this end must be called.
        now: instead of the clock's.

    Raises:
        TransportError: expired, not yet valid, of another authority, of another or a revoked name, or no certificate.
    """
    from cryptography import x509  # 40 ms that no other link needs

    chains = []
    for path in (ca, cert):
        try:
            chains.append(x509.load_pem_x509_certificates(Path(path).read_bytes()))
        except (OSError, ValueError) as error:
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
