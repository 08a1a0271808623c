"""New certificates for keys that are there: of the authority and of all ends."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding

from hil.files.authority import authority_key, read_certificate
from hil.files.exclusive import written_whole
from hil.files.keys import BEFORE


def renew_certificates(folder: Path, days: int = 365) -> list[Path]:
    """Replace the certificates in a folder by such as begin now, for the same keys, names and hosts.

    The other end needs its new .pem, and both need ca.pem; what was valid before stays valid until it ends.

    Args:
        folder: made by `make_keys`; it holds ca.key.
        days: how long the new ones are valid.

    Returns:
        The files: ca.pem, then every other .pem that is there.

    Raises:
        HilError: ca.key or a certificate is not to be had, or they do not belong together; then nothing is replaced.
    """
    begin = datetime.now(UTC) - BEFORE
    root, _ = authority_key(folder, "certificates are renewed")
    made: list[tuple[Path, bytes]] = []
    for path in sorted(folder.glob("*.pem"), key=lambda path: (path.name != "ca.pem", path.name)):
        renewed = _renewed(read_certificate(path), root, begin, begin + timedelta(days=days))
        made.append((path, renewed.public_bytes(Encoding.PEM)))
    for path, data in made:
        with written_whole(path, replace=True) as part:
            part.write_bytes(data)
            part.chmod(0o644)
    return [path for path, _ in made]


def _renewed(old: x509.Certificate, root: ec.EllipticCurvePrivateKey, begin: datetime, end: datetime) -> x509.Certificate:
    key: Any = old.public_key()
    builder = x509.CertificateBuilder(issuer_name=old.issuer, subject_name=old.subject, public_key=key)
    builder = builder.serial_number(x509.random_serial_number()).not_valid_before(begin).not_valid_after(end)
    for extension in old.extensions:
        builder = builder.add_extension(extension.value, extension.critical)
    return builder.sign(root, hashes.SHA256())
