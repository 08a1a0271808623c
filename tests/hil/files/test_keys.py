"""Keys and certificates of a test authority: what they are good for, for whom and how long, and what is refused."""

from __future__ import annotations

import fcntl
import ipaddress
import os
import re
import stat
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec, ed25519
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, load_pem_private_key
from cryptography.x509.oid import ExtendedKeyUsageOID

from hil.errors import HilError
from hil.files.keys import BEFORE, authority_key, issue_certificate, make_keys, read_certificate, renew_certificates, revoke_names
from hil.files.signature import Signer, make_signing_key
from tests.file_limit import files_up_to
from tests.hil.cli.conftest import Hil
from tests.hil.cli.conftest import cli as cli
from transport.links import TransportError
from transport.links.authentication import revoked_names

LOCAL = [x509.DNSName("localhost"), *(x509.IPAddress(ipaddress.ip_address(each)) for each in ("127.0.0.1", "::1"))]
BOTH = [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    make_keys(tmp_path / "a" / "keys", ["rig.lab", "10.1.2.3", "localhost"], days=2)
    return tmp_path / "a" / "keys"


def called(certificate: x509.Certificate) -> str:
    (name,) = certificate.subject
    return str(name.value)


def assert_is_good(path: Path, root: x509.Certificate, hosts: list[x509.GeneralName], days: int) -> None:
    """It is of the authority, no authority itself, for both ends of TLS, for these hosts, and from a little before now on."""
    found = read_certificate(path)
    found.verify_directly_issued_by(root)
    basic = found.extensions.get_extension_for_class(x509.BasicConstraints)
    assert basic.critical and basic.value == x509.BasicConstraints(ca=False, path_length=None)
    names = found.extensions.get_extension_for_class(x509.SubjectAlternativeName)
    usage = found.extensions.get_extension_for_class(x509.ExtendedKeyUsage)
    assert list(names.value) == hosts and list(usage.value) == BOTH and not names.critical and not usage.critical
    key = load_pem_private_key(path.with_suffix(".key").read_bytes(), None)
    assert key.public_key() == found.public_key() != root.public_key() and called(found) == path.stem
    assert_is_valid(found, days)


def assert_is_valid(found: x509.Certificate, days: int) -> None:
    begin, end = found.not_valid_before_utc, found.not_valid_after_utc
    assert end - begin == timedelta(days=days) and timedelta() <= datetime.now(UTC) - BEFORE - begin < timedelta(minutes=5)


def test_an_authority_signs_a_certificate_for_each_end_and_only_its_owner_reads_its_keys(folder: Path) -> None:
    root = read_certificate(folder / "ca.pem")
    root.verify_directly_issued_by(root)
    basic = root.extensions.get_extension_for_class(x509.BasicConstraints)
    assert basic.critical and basic.value == x509.BasicConstraints(ca=True, path_length=0)
    assert_is_valid(root, 2)
    hosts = [*LOCAL, x509.DNSName("rig.lab"), x509.IPAddress(ipaddress.ip_address("10.1.2.3"))]
    for name in ("rig", "controller"):
        assert_is_good(folder / f"{name}.pem", root, hosts, 2)
    assert re.fullmatch(r"[0-9a-f]{32}\n", (folder / "frames.key").read_text())
    modes = {path.name: stat.S_IMODE(path.stat().st_mode) for path in folder.iterdir()}
    assert modes == {f"{name}.{kind}": 0o600 if kind == "key" else 0o644
                     for name, kind in [(name, kind) for name in ("ca", "rig", "controller") for kind in ("pem", "key")]
                     + [("frames", "key")]}  # fmt: skip
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert len({read_certificate(path).serial_number for path in folder.glob("*.pem")}) == 3


def test_a_folder_that_is_not_new_or_not_ones_own_takes_no_keys(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(HilError, match="keys: is not empty; keys are made in a new folder"):
        make_keys(folder)
    for mode in (0o701, 0o710, 0o750):
        (open_ := tmp_path / f"{mode:o}").mkdir()
        open_.chmod(mode)
        with pytest.raises(HilError, match="other users can enter it; chmod 700 it"):
            make_keys(open_)
        assert not any(open_.iterdir())
    (tmp_path / "file").touch()
    with pytest.raises(HilError, match="file: cannot be written: File exists"):
        make_keys(tmp_path / "file")
    with pytest.raises(HilError, match="--host 'ä': neither an address nor a name"):
        make_keys(tmp_path / "new", ["ä"])
    with files_up_to(550), pytest.raises(HilError, match=r"cannot be written: File too large"):  # ca.pem and ca.key fit
        make_keys(tmp_path / "new")
    assert not any((tmp_path / "new").iterdir()) and make_keys(tmp_path / "new"), "all of them, or none"


def test_the_commands_print_each_file_and_how_a_link_takes_it(cli: Hil) -> None:
    lines = cli("keys", "new", "k")[1].splitlines()
    names = ("ca.pem", "ca.key", "rig.pem", "rig.key", "controller.pem", "controller.key", "frames.key")
    assert lines[:7] == [f"k/{name}" for name in names] and lines[7].startswith("zenoh:tls/127.0.0.1:7447?keys=k ")
    assert lines[8].startswith("can:hil:rig0?auth=k/frames.key ") and len(lines) == 9
    *files, link = cli("keys", "issue", "k", "bench2")[1].splitlines()
    assert files == ["k/bench2.pem", "k/bench2.key"]
    assert link == "zenoh:tls/127.0.0.1:7447?keys=k&controller=bench2   or &rig=bench2, at both ends"


def test_a_name_of_ones_own_gets_a_certificate_once_unless_it_is_revoked(folder: Path) -> None:
    root = read_certificate(folder / "ca.pem")
    assert issue_certificate(folder, "alice", ["10.0.0.7"], days=5) == [folder / "alice.pem", folder / "alice.key"]
    assert_is_good(folder / "alice.pem", root, [*LOCAL, x509.IPAddress(ipaddress.ip_address("10.0.0.7"))], 5)
    before = (folder / "alice.key").read_bytes()
    with pytest.raises(HilError, match=r"alice\.(pem|key): "):
        issue_certificate(folder, "alice")
    assert (folder / "alice.key").read_bytes() == before
    for name in ("", "a b", "a/b", "x" * 65, "ca", "frames", "signing"):
        with pytest.raises(HilError, match="expected up to 64 letters"):
            issue_certificate(folder, name)
    issue_certificate(folder, "x" * 64)
    assert_is_valid(read_certificate(folder / f"{'x' * 64}.pem"), 365)
    revoke_names(folder, ["mallory"])
    with pytest.raises(HilError, match="the name mallory is revoked; choose another one"):
        issue_certificate(folder, "mallory")
    assert not (folder / "mallory.pem").exists()


def test_revoked_names_are_a_sorted_list_beside_the_authority_that_grows(folder: Path, tmp_path: Path) -> None:
    kept = revoke_names(folder, ["zoe", "bob"])
    assert revoke_names(folder, ["alice", "bob"]) == kept and kept.parent == folder
    assert kept.read_text() == "alice\nbob\nzoe\n" and stat.S_IMODE(kept.stat().st_mode) == 0o644
    with pytest.raises(HilError, match="name 'a b': expected up to 64 letters"):
        revoke_names(folder, ["carol", "a b"])
    with pytest.raises(HilError, match=r"ca\.pem: no such file; the list stands beside"):
        revoke_names(tmp_path, ["carol"])
    kept.write_bytes(b"\xff\xfe")
    with pytest.raises(TransportError, match=kept.name):
        revoke_names(folder, ["carol"])
    assert kept.read_bytes() == b"\xff\xfe"


def test_who_revokes_reads_and_writes_the_list_while_no_other_does(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read: list[Path] = []

    def names(ca: Path) -> frozenset[str]:
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            with pytest.raises(BlockingIOError):
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        finally:
            os.close(descriptor)
        read.append(ca)
        return revoked_names(ca)

    monkeypatch.setattr("hil.files.keys.revoked_names", names)
    for name in ("bob", "alice"):
        assert revoke_names(folder, [name]).is_file()
    assert read == [folder / "ca.pem"] * 2 and revoked_names(folder / "ca.pem") == {"alice", "bob"}


def test_renewed_certificates_are_the_same_but_for_their_time(folder: Path) -> None:
    issue_certificate(folder, "alice")
    old = {path: read_certificate(path) for path in folder.glob("*.pem")}
    files = renew_certificates(folder, days=9)
    assert files == [folder / f"{name}.pem" for name in ("ca", "alice", "controller", "rig")]
    root = read_certificate(files[0])
    for path in files:
        new = read_certificate(path)
        new.verify_directly_issued_by(root)
        assert_is_valid(new, 9)
        assert (new.subject, new.issuer, new.public_key()) == (old[path].subject, old[path].issuer, old[path].public_key())
        assert [(each.value, each.critical) for each in new.extensions] == [
            (each.value, each.critical) for each in old[path].extensions
        ]  # fmt: skip
        assert new.serial_number != old[path].serial_number and stat.S_IMODE(path.stat().st_mode) == 0o644


def test_a_key_of_another_kind_or_another_authority_signs_nothing(folder: Path, tmp_path: Path) -> None:
    key, _ = authority_key(folder, "tests are made")
    assert isinstance(key, ec.EllipticCurvePrivateKey)
    make_keys(tmp_path / "other")
    (folder / "ca.pem").write_bytes((tmp_path / "other" / "ca.pem").read_bytes())
    other = ed25519.Ed25519PrivateKey.generate().private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    for data, said in (
        (None, "is not the certificate of .*ca.key"), (other, "expected a key as `hil keys new` makes it"),
        (b"none", "is no private key in PEM"),
    ):  # fmt: skip
        if data is not None:
            (folder / "ca.key").write_bytes(data)
        with pytest.raises(HilError, match=said):
            issue_certificate(folder, "alice")
    (folder / "ca.key").unlink()
    with pytest.raises(HilError, match="certificates are issued where the authority's key is kept"):
        issue_certificate(folder, "alice")
    assert not (folder / "alice.pem").exists()
    (folder / "ca.pem").write_text("none")
    with pytest.raises(HilError, match=r"ca\.pem: is no certificate"):
        read_certificate(folder / "ca.pem")


def test_a_signing_key_is_made_once_and_is_of_one_kind(folder: Path, tmp_path: Path) -> None:
    private, public = make_signing_key(tmp_path / "s")
    assert [stat.S_IMODE(path.stat().st_mode) for path in (private, public)] == [0o600, 0o644]
    Signer(private)
    with pytest.raises(HilError, match="has a signing key already; it is not replaced"):
        make_signing_key(tmp_path / "s")
    private.unlink()
    with pytest.raises(HilError, match="has a signing key already"):
        make_signing_key(tmp_path / "s")
    with pytest.raises(HilError, match=r"rig\.key: is no Ed25519 key; make one: hil keys signing FOLDER"):
        Signer(folder / "rig.key")
    (tmp_path / "file").touch()
    with pytest.raises(HilError, match="file: cannot be written"):
        make_signing_key(tmp_path / "file")
