"""New certificates for keys that are there: of the authority, of the rig and of the controller."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, load_pem_private_key

from hil.errors import HilError
from hil.files.exclusive import written_whole
from hil.files.keys import BEFORE, ENDS
from transport.links.link import TransportError
from transport.links.secret_file import read_secret


def renew_certificates(folder: Path, days: int = 365) -> list[Path]:
    """Replace the certificates in a folder by such as begin now, for the same keys, names and hosts.

    The other end needs its new .pem, and both need ca.pem; what was valid before stays valid until it ends.

    Args:
        folder: made by `make_keys`; it holds ca.key.
        days: how long the new ones are valid.

    Returns:
        The files: ca.pem and the .pem of each end that is there.

    Raises:
        HilError: ca.key or a certificate is not to be had, or they do not belong together; then nothing is replaced.
    """
    begin = datetime.now(UTC) - BEFORE
    try:
        root = load_pem_private_key(read_secret(str(folder / "ca.key"), "the private key of the authority"), None)
    except (TransportError, ValueError, TypeError) as error:
        raise HilError(f"{error}; certificates are renewed where the authority's key is kept") from error
    if not isinstance(root, ec.EllipticCurvePrivateKey):
        raise HilError(f"{folder / 'ca.key'}: expected a key as `hil keys new` makes it")
    made: list[tuple[Path, bytes]] = []
    for path in [folder / "ca.pem", *(folder / f"{end}.pem" for end in ENDS if (folder / f"{end}.pem").exists())]:
        old = _certificate(path)
        if path.name == "ca.pem" and old.public_key() != root.public_key():
            raise HilError(f"{path}: is not the certificate of {folder / 'ca.key'}")
        made.append((path, _renewed(old, root, begin, begin + timedelta(days=days)).public_bytes(Encoding.PEM)))
    for path, data in made:
        with written_whole(path, replace=True) as part:
            part.write_bytes(data)
            part.chmod(0o644)
    return [path for path, _ in made]


def _certificate(path: Path) -> x509.Certificate:
    try:
        return x509.load_pem_x509_certificate(path.read_bytes())
    except (OSError, ValueError) as error:
        raise HilError(f"{path}: is no certificate: {error}") from error


def _renewed(old: x509.Certificate, root: ec.EllipticCurvePrivateKey, begin: datetime, end: datetime) -> x509.Certificate:
    key: Any = old.public_key()
    builder = x509.CertificateBuilder(issuer_name=old.issuer, subject_name=old.subject, public_key=key)
    builder = builder.serial_number(x509.random_serial_number()).not_valid_before(begin).not_valid_after(end)
    for extension in old.extensions:
        builder = builder.add_extension(extension.value, extension.critical)
    return builder.sign(root, hashes.SHA256())
