"""What follows on `hil.files.keys.make_keys` where the authority's key is: certificates for keys or names, and revocations."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Final

from hil.errors import HilError
from hil.files.keys import BEFORE, end_files, new_files
from hil.files.outputs import written_whole
from transport.links.certificates import FILE, revoked_names
from transport.links.cryptography_package import cryptography_needed
from transport.links.link import TransportError
from transport.links.private_directory import read_secret

with cryptography_needed():
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes
    from cryptography.hazmat.primitives.asymmetric import ec
    from cryptography.hazmat.primitives.serialization import Encoding, load_pem_private_key

_NAME: Final = re.compile(r"[A-Za-z0-9_.-]{1,64}")
_TAKEN: Final = ("ca", "frames", "signing")


def authority_key(folder: Path, what: str) -> tuple[ec.EllipticCurvePrivateKey, x509.Certificate]:
    """Return the key of an authority and its certificate.

    Args:
        folder: made by `make_keys`; it holds ca.key.
        what: what is done with it, for the message.

    Raises:
        HilError: one is not to be had, or they do not belong together.
    """
    try:
        root = load_pem_private_key(read_secret(str(folder / "ca.key"), "the private key of the authority"), None)
    except (TransportError, ValueError, TypeError) as error:
        raise HilError(f"{error}; {what} where the authority's key is kept") from error
    if not isinstance(root, ec.EllipticCurvePrivateKey):
        raise HilError(f"{folder / 'ca.key'}: expected a key as `hil keys new` makes it")
    path = folder / "ca.pem"
    certificate = read_certificate(path)
    if certificate.public_key() != root.public_key():
        raise HilError(f"{path}: is not the certificate of {folder / 'ca.key'}")
    return root, certificate


def read_certificate(path: Path) -> x509.Certificate:
    """Return the certificate in a file.

    Raises:
        HilError: there is none.
    """
    try:
        return x509.load_pem_x509_certificate(path.read_bytes())
    except (OSError, ValueError) as error:
        raise HilError(f"{path}: is no certificate: {error}") from error


def issue_certificate(folder: Path, name: str, hosts: Sequence[str] = (), days: int = 365) -> list[Path]:
    """Make a private key and a certificate of a new name, in the folder of its authority.

    Args:
        folder: made by `make_keys`; it holds ca.key.
        name: up to 64 letters, digits, '_', '-', '.'; not revoked, and not there yet.
        hosts: names and addresses at which a rig of that name can be reached, besides localhost.
        days: how long the certificate is valid.

    Returns:
        The files: NAME.pem, NAME.key.

    Raises:
        HilError: the authority's key is not to be had, or the name cannot.
    """
    if not _NAME.fullmatch(name) or name in _TAKEN:
        raise HilError(f"name {name!r:.80}: expected up to 64 letters, digits, '_', '-', '.', and none of {', '.join(_TAKEN)}")
    root, certificate = authority_key(folder, "certificates are issued")
    if name in _revoked(folder):
        raise HilError(f"{folder / FILE}: the name {name} is revoked; choose another one")
    begin = datetime.now(UTC) - BEFORE
    files = end_files(folder, name, root, certificate.subject, hosts, begin, begin + timedelta(days=days))
    try:
        return new_files(files)
    except OSError as error:
        raise HilError(f"{error.filename or folder}: cannot be written: {error.strerror}") from error


def revoke_names(folder: Path, names: Sequence[str]) -> Path:
    """Put names on the list of those that are let in no more; both ends need the list beside their ca.pem.

    Args:
        folder: of an authority's certificate.
        names: of certificates.

    Returns:
        The list.

    Raises:
        HilError: a name that is none, no ca.pem there, or the list cannot be read or written.
    """
    for name in names:
        if not _NAME.fullmatch(name):
            raise HilError(f"name {name!r:.80}: expected up to 64 letters, digits, '_', '-', '.'")
    if not os.path.isfile(folder / "ca.pem"):
        raise HilError(f"{folder / 'ca.pem'}: no such file; the list stands beside the certificate of the authority")
    every = sorted(_revoked(folder) | set(names))
    with written_whole(folder / FILE, replace=True) as part:
        part.write_text("".join(f"{name}\n" for name in every))
        part.chmod(0o644)
    return folder / FILE


def _revoked(folder: Path) -> frozenset[str]:
    try:
        return revoked_names(folder / "ca.pem")
    except TransportError as error:
        raise HilError(str(error)) from error


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
