"""Keys and certificates for a rig and its controller: a test authority, one certificate each, and the key of the frames."""

from __future__ import annotations

import ipaddress
import os
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Final

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from hil.errors import HilError

AUTHORITY: Final = "hilrig test CA"
ENDS: Final = ("rig", "controller")
BEFORE: Final = timedelta(minutes=5)  # clocks of two machines differ


def make_keys(folder: Path, hosts: Sequence[str] = (), days: int = 365) -> list[Path]:
    """Make a test authority, a certificate for each end, and the key of the frames, in a new folder of mode 0700.

    Every private key is a file of mode 0600. The certificates are called *rig* and *controller*, by which the access-control
    list of a zenoh link tells them apart; both are good for ``localhost`` and 127.0.0.1 besides the hosts that are named.

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
    names: list[x509.GeneralName] = [_general(host) for host in dict.fromkeys(("localhost", "127.0.0.1", "::1", *hosts))]
    root = ec.generate_private_key(ec.SECP256R1())
    issuer = _name(AUTHORITY)

    def certificate(called: x509.Name, key: ec.EllipticCurvePrivateKey) -> x509.CertificateBuilder:
        builder = x509.CertificateBuilder(issuer_name=issuer, subject_name=called, public_key=key.public_key())
        builder = builder.serial_number(x509.random_serial_number()).not_valid_before(begin).not_valid_after(end)
        return builder.add_extension(x509.BasicConstraints(ca=key is root, path_length=0 if key is root else None), critical=True)

    made = [
        _new(folder / "ca.pem", certificate(issuer, root).sign(root, hashes.SHA256()).public_bytes(Encoding.PEM), 0o644),
        _new(folder / "ca.key", _pem(root), 0o600),
    ]
    for end_of_link in ENDS:
        key = ec.generate_private_key(ec.SECP256R1())
        usage = x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH])
        builder = certificate(_name(end_of_link), key).add_extension(x509.SubjectAlternativeName(names), critical=False)
        signed = builder.add_extension(usage, critical=False).sign(root, hashes.SHA256())
        made.append(_new(folder / f"{end_of_link}.pem", signed.public_bytes(Encoding.PEM), 0o644))
        made.append(_new(folder / f"{end_of_link}.key", _pem(key), 0o600))
    made.append(_new(folder / "frames.key", os.urandom(16).hex().encode() + b"\n", 0o600))
    return made


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


def _new(path: Path, data: bytes, mode: int) -> Path:
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC, mode)
    with open(descriptor, "wb") as file:
        file.write(data)
    return path
