"""Keys and certificates for a rig and its controller: a test authority, one certificate each, and the key of the frames."""

from __future__ import annotations

import ipaddress
import os
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Final

from hil.errors import HilError
from transport.links.cryptography_package import cryptography_needed

with cryptography_needed():
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes
    from cryptography.hazmat.primitives.asymmetric import ec
    from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
    from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

AUTHORITY: Final = "hilrig test CA"
ENDS: Final = ("rig", "controller")
File = tuple[Path, bytes, int]
"""Path, contents, mode."""

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
        HilError: the folder is not to be had, or there is something in it.
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
    own = _certificate(issuer, issuer, root, begin, end, 0).sign(root, hashes.SHA256())
    files = [(folder / "ca.pem", own.public_bytes(Encoding.PEM), 0o644), (folder / "ca.key", _pem(root), 0o600)]
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
    builder = _certificate(issuer, _name(name), key, begin, end, None)
    builder = builder.add_extension(x509.SubjectAlternativeName(names), critical=False).add_extension(usage, critical=False)
    signed = builder.sign(root, hashes.SHA256()).public_bytes(Encoding.PEM)
    return [(folder / f"{name}.pem", signed, 0o644), (folder / f"{name}.key", _pem(key), 0o600)]


def _certificate(
    issuer: x509.Name, called: x509.Name, key: ec.EllipticCurvePrivateKey, begin: datetime, end: datetime, path_length: int | None
) -> x509.CertificateBuilder:
    builder = x509.CertificateBuilder(issuer_name=issuer, subject_name=called, public_key=key.public_key())
    builder = builder.serial_number(x509.random_serial_number()).not_valid_before(begin).not_valid_after(end)
    basic = x509.BasicConstraints(ca=path_length is not None, path_length=path_length)
    return builder.add_extension(basic, critical=True)


def _name(common: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common)])


def _general(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        pass
    try:
        return x509.DNSName(host)
    except ValueError as error:
        raise HilError(f"--host {host!r:.80}: neither an address nor a name: {error}") from error


def _pem(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())


def new_files(files: Sequence[File]) -> list[Path]:
    """Make files that are not there yet, and return their paths.

    Raises:
        OSError: one is there, or cannot be written.
    """
    for path, data, mode in files:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC, mode)
        with open(descriptor, "wb") as file:
            file.write(data)
    return [path for path, _, _ in files]
