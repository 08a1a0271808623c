"""A signature of a log: who holds the private key wrote these bytes. It stands beside the log, in ``run.mcap.sig``.

The log itself stays as it is, so that every reader reads it, and one that was cut or mended is seen to be other bytes. Signed is
the text ``hilrig log``, the SHA-256 and the length of the file, by Ed25519 (RFC 8032).
"""

from __future__ import annotations

import base64
import hashlib
import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Final

from hil.errors import HilError
from hil.files import new_files, read_regular, written_whole
from transport.links.authentication import cryptography_needed
from transport.links.private_directory import read_secret

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

SUFFIX: Final = ".sig"
MOST_BYTES: Final = 4096


class BadSignature(HilError):
    """A log is not what the holder of the key signed."""


class Signer:
    """Signs logs with a private key.

    Args:
        key: file of an Ed25519 private key in PEM, which only its owner can read.

    Raises:
        HilError: the file is no such key.
        TransportError: it cannot be read, or others can read it.
    """

    def __init__(self, key: Path) -> None:
        with cryptography_needed():
            from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
            from cryptography.hazmat.primitives.serialization import load_pem_private_key

        data = read_secret(str(key), "the key that signs logs")
        try:
            found = load_pem_private_key(data, None)
        except (ValueError, TypeError) as error:
            raise HilError(f"{key}: is no private key in PEM without a password: {error!s:.80}") from error
        if not isinstance(found, Ed25519PrivateKey):
            raise HilError(f"{key}: is no Ed25519 key; make one: hil keys signing FOLDER")
        self._key: Ed25519PrivateKey = found

    def sign(self, log: Path, sha256: str, size: int) -> Path:
        """Write the signature of a log beside it, in the place of an older one.

        Args:
            log: the file.
            sha256: of its bytes, in hexadecimal.
            size: how many.

        Raises:
            HilError: the signature cannot be written.
        """
        signature = base64.b64encode(self._key.sign(_text(sha256, size))).decode()
        document = {
            "algorithm": "Ed25519", "sha256": sha256, "bytes": size, "key": fingerprint(self._key.public_key()),
            "signature": signature,
        }  # fmt: skip
        path = signature_of(log)
        with written_whole(path, replace=True) as part:
            part.write_text(json.dumps(document, indent=1) + "\n", encoding="ascii")
        return path


def check_signature(log: Path, key: Path, file: BinaryIO) -> str:
    """Check that an open log is what the holder of a key signed; return the key's fingerprint.

    Args:
        log: its name, beside which the signature stands.
        key: file of the Ed25519 public key in PEM.
        file: the log, open; it is read from its begin.

    Raises:
        BadSignature: other bytes, another key, or a signature that was changed.
        HilError: the key or the signature cannot be read.
    """
    with cryptography_needed():
        from cryptography.exceptions import InvalidSignature

    public = _public(key)
    path = signature_of(log)
    if not os.path.lexists(path):
        raise HilError(f"{log}: is not signed: there is no {path.name} beside it")
    data = read_regular(path, MOST_BYTES, "the signature of a log")
    try:
        said = json.loads(data)
        signature = base64.b64decode(said["signature"], validate=True)
        sha256, size, named = said["sha256"], said["bytes"], said["key"]
        if not (isinstance(sha256, str) and type(size) is int and isinstance(named, str)):
            raise TypeError("sha256 and key are text, bytes is a whole number")
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise BadSignature(f"{path}: is no signature of a log") from error
    if named != fingerprint(public):
        raise BadSignature(f"{log}: was signed with the key {named!r:.90}, not with {key} ({fingerprint(public)})")
    try:
        public.verify(signature, _text(sha256, size))
    except InvalidSignature as error:
        raise BadSignature(f"{path}: the signature is not that of {key}: it was changed") from error
    file.seek(0)
    found = hashlib.file_digest(file, "sha256").hexdigest()  # type: ignore[arg-type]
    length = os.fstat(file.fileno()).st_size
    if length != size:
        raise BadSignature(f"{log}: has {length} bytes, {size} were signed")
    if found != sha256:
        raise BadSignature(f"{log}: its bytes are not those that were signed")
    return named


def make_signing_key(folder: Path) -> list[Path]:
    """Make a pair of keys in a folder: ``signing.key`` of mode 0600, and ``signing.pub``.

    Raises:
        HilError: one of the files is there, or the folder cannot be written.
    """
    with cryptography_needed():
        from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
        from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, PublicFormat

    key = Ed25519PrivateKey.generate()
    files = (
        (folder / "signing.key", key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()), 0o600),
        (folder / "signing.pub", key.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo), 0o644),
    )
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if any(os.path.lexists(path) for path, _, _ in files):
            raise HilError(f"{folder}: has a signing key already; it is not replaced")
        return new_files(files)
    except OSError as error:
        raise HilError(f"{error.filename or folder}: cannot be written: {error.strerror}") from error


def signature_of(log: Path) -> Path:
    """Return where the signature of a log stands."""
    return log.with_name(log.name + SUFFIX)


def fingerprint(key: Ed25519PublicKey) -> str:
    """Return the SHA-256 of a public key, as OpenSSH writes it."""
    digest = hashlib.sha256(key.public_bytes_raw()).digest()
    return f"SHA256:{base64.b64encode(digest).decode().rstrip('=')}"


def _public(path: Path) -> Ed25519PublicKey:
    with cryptography_needed():
        from cryptography.exceptions import UnsupportedAlgorithm
        from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
        from cryptography.hazmat.primitives.serialization import load_pem_public_key

    data = read_regular(path, MOST_BYTES, "a public key")
    try:
        found = load_pem_public_key(data)
    except (ValueError, TypeError, UnsupportedAlgorithm) as error:
        raise HilError(f"{path}: is no public key in PEM; expected the signing.pub of `hil keys signing`") from error
    if not isinstance(found, Ed25519PublicKey):
        raise HilError(f"{path}: is no Ed25519 key; expected the signing.pub of `hil keys signing`")
    return found


def _text(sha256: str, size: int) -> bytes:
    return f"hilrig log\nsha256 {sha256}\nbytes {size}\n".encode("ascii", "backslashreplace")
