"""Keys and certificates for a rig and its controller: a test authority, what it signs and revokes, and the key of the frames."""

from __future__ import annotations

import fcntl
import ipaddress
import os
import re
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Final

from hil.errors import HilError, located
from hil.files import File, new_files, read_regular, written_whole
from transport.links import TransportError
from transport.links.authentication import REVOKED, cryptography_needed, revoked_names
from transport.links.private_directory import MOST_BYTES, read_secret

with cryptography_needed():
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes
    from cryptography.hazmat.primitives.asymmetric import ec
    from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, load_pem_private_key
    from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

AUTHORITY: Final = "hilrig test CA"
ENDS: Final = ("rig", "controller")
_NAME: Final = re.compile(r"[A-Za-z0-9_.-]{1,64}")
_TAKEN: Final = ("ca", "frames", "signing")

BEFORE: Final = timedelta(minutes=5)  # clocks of two machines differ


def make_keys(folder: Path, hosts: Sequence[str] = (), days: int = 365) -> list[Path]:
    """Make a test authority, a certificate for each end, and the key of the frames, in a new folder of mode 0700.

    Every private key is a file of mode 0600. The certificates are called *rig* and *controller*, by which the access-control
    list of a zenoh link distinguishes them; both are good for ``localhost`` and 127.0.0.1 besides the hosts that are named.

    Args:
        folder: does not exist, or is empty and its owner's alone.
        hosts: names and addresses at which the rig can be reached.
        days: how long the certificates are valid.

    Returns:
        The files: ca.pem, ca.key, then .pem and .key of rig and controller, then frames.key.

    Raises:
        HilError: the folder cannot be made, or there is something in it.
    """
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        status = folder.stat()
        if any(folder.iterdir()):
            raise HilError(f"{folder}: is not empty; keys are made in a new folder")
        if status.st_mode & 0o077 or status.st_uid != os.geteuid():
            raise HilError(f"{folder}: other users can enter it; chmod 700 it, or choose another one")
        return _write(folder, hosts, days)
    except OSError as error:
        raise HilError(f"{error.filename or folder}: cannot be written: {error.strerror}") from error


def _write(folder: Path, hosts: Sequence[str], days: int) -> list[Path]:
    begin = datetime.now(UTC) - BEFORE
    end = begin + timedelta(days=days)
    root, issuer = ec.generate_private_key(ec.SECP256R1()), _name(AUTHORITY)
    builder = _certificate(issuer, issuer, root.public_key(), begin, end).add_extension(_basic(0), critical=True)
    own = builder.sign(root, hashes.SHA256()).public_bytes(Encoding.PEM)
    files = [(folder / "ca.pem", own, 0o644), (folder / "ca.key", _pem(root), 0o600)]
    for name in ENDS:
        files += end_files(folder, name, root, issuer, hosts, begin, end)
    return new_files([*files, (folder / "frames.key", os.urandom(16).hex().encode() + b"\n", 0o600)])


def end_files(
    folder: Path, name: str, root: ec.EllipticCurvePrivateKey, issuer: x509.Name, hosts: Sequence[str], begin: datetime,
    end: datetime,
) -> list[File]:  # fmt: skip
    """Return certificate and private key of a new end of a link, as files that are to be made.

    Args:
        folder: where they will stand.
        name: what the end is called.
        root: key of the authority.
        issuer: what the authority is called.
        hosts: names and addresses at which the end can be reached, besides localhost.
        begin: from when the certificate is valid.
        end: until when.
    """
    names: list[x509.GeneralName] = [_general(host) for host in dict.fromkeys(("localhost", "127.0.0.1", "::1", *hosts))]
    key = ec.generate_private_key(ec.SECP256R1())
    usage = x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH])
    builder = _certificate(issuer, _name(name), key.public_key(), begin, end).add_extension(_basic(None), critical=True)
    builder = builder.add_extension(x509.SubjectAlternativeName(names), critical=False).add_extension(usage, critical=False)
    signed = builder.sign(root, hashes.SHA256()).public_bytes(Encoding.PEM)
    return [(folder / f"{name}.pem", signed, 0o644), (folder / f"{name}.key", _pem(key), 0o600)]


def _certificate(issuer: x509.Name, called: x509.Name, public: Any, begin: datetime, end: datetime) -> x509.CertificateBuilder:
    builder = x509.CertificateBuilder(issuer_name=issuer, subject_name=called, public_key=public)
    return builder.serial_number(x509.random_serial_number()).not_valid_before(begin).not_valid_after(end)


def _basic(path_length: int | None) -> x509.BasicConstraints:
    return x509.BasicConstraints(ca=path_length is not None, path_length=path_length)


def _name(common: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common)])


def _general(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        pass
    with located(f"--host {host!r:.80}: neither an address nor a name", ValueError):
        return x509.DNSName(host)


def _pem(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())


def authority_key(folder: Path, what: str) -> tuple[ec.EllipticCurvePrivateKey, x509.Certificate]:
    """Return the key of an authority and its certificate.

    Args:
        folder: made by `make_keys`; it holds ca.key.
        what: what is done with it, for the message.

    Raises:
        HilError: one cannot be read, or they do not belong together.
    """
    try:
        data = read_secret(str(folder / "ca.key"), "the private key of the authority")
    except TransportError as error:
        raise HilError(f"{error}; {what} where the authority's key is kept") from error
    with located(f"{folder / 'ca.key'}: is no private key in PEM", ValueError, TypeError):
        root = load_pem_private_key(data, None)
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
    data = read_regular(path, MOST_BYTES, "a certificate")
    with located(f"{path}: is no certificate", ValueError):
        return x509.load_pem_x509_certificate(data)


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
        HilError: the authority's key cannot be read, or the name cannot.
        TransportError: the list of revoked names cannot be read.
    """
    if not _NAME.fullmatch(name) or name in _TAKEN:
        raise HilError(f"name {name!r:.80}: expected up to 64 letters, digits, '_', '-', '.', and none of {', '.join(_TAKEN)}")
    root, certificate = authority_key(folder, "certificates are issued")
    if name in revoked_names(folder / "ca.pem"):
        raise HilError(f"{folder / REVOKED}: the name {name} is revoked; choose another one")
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
        HilError: a name that is none, no ca.pem there, or the list cannot be written.
        TransportError: the list cannot be read.
    """
    for name in names:
        if not _NAME.fullmatch(name):
            raise HilError(f"name {name!r:.80}: expected up to 64 letters, digits, '_', '-', '.'")
    if not os.path.isfile(folder / "ca.pem"):
        raise HilError(f"{folder / 'ca.pem'}: no such file; the list stands beside the certificate of the authority")
    descriptor = os.open(folder, os.O_RDONLY | os.O_CLOEXEC)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)  # of two commands at once the second adds to what the first has written
        every = sorted(revoked_names(folder / "ca.pem") | set(names))
        with written_whole(folder / REVOKED, replace=True) as part:
            part.write_text("".join(f"{name}\n" for name in every))
            part.chmod(0o644)
    finally:
        os.close(descriptor)
    return folder / REVOKED


def renew_certificates(folder: Path, days: int = 365) -> list[Path]:
    """Replace the certificates in a folder by such as begin now, for the same keys, names and hosts.

    The other end needs its new .pem, and both need ca.pem; what was valid before stays valid until it ends.

    Args:
        folder: made by `make_keys`; it holds ca.key.
        days: how long the new ones are valid.

    Returns:
        The files: ca.pem, then every other .pem that is there.

    Raises:
        HilError: ca.key or a certificate cannot be read, or they do not belong together; then nothing is replaced.
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
    builder = _certificate(old.issuer, old.subject, old.public_key(), begin, end)
    for extension in old.extensions:
        builder = builder.add_extension(extension.value, extension.critical)
    return builder.sign(root, hashes.SHA256())
