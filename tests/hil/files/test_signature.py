"""A signed log: what is other bytes, another key or no signature is named, with an exit status."""

from __future__ import annotations

import re
import shutil
import stat
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from hil.log.read.recover import recover
from tests.hil.cli.conftest import Hil
from tests.hil.cli.conftest import cli as cli


@pytest.fixture
def signed(cli: Hil, tmp_path: Path) -> Path:
    """A log of a second with its signature, and the keys beside it."""
    status, out, _ = cli("keys", "signing", "my keys")
    assert status == 0 and "--sign 'my keys/signing.key' " in out and "--key 'my keys/signing.pub' " in out
    Path("my keys").rename("k")
    status, out, err = cli("run", "dc-motor-hinf", "--duration", "1", "-o", "l.mcap", "--sign", "k/signing.key", "--json")
    assert status == 0 and '"signature": "l.mcap.sig"' in out, err
    return tmp_path / "l.mcap"


def check(cli: Hil, *, log: str = "l.mcap", key: str = "k/signing.pub") -> tuple[int, str]:
    status, out, err = cli("replay", log, "--verify", "--key", key)
    return status, out + err


def test_a_signed_log_is_verified_and_read_without_knowledge_of_signatures(cli: Hil, signed: Path) -> None:
    status, reported = check(cli)
    assert status == 0 and "signed with k/signing.pub (SHA256:" in reported and "same bits" in reported
    assert cli("replay", "l.mcap")[0] == 0
    assert stat.S_IMODE(Path("k/signing.key").stat().st_mode) == 0o600


@pytest.mark.parametrize("at", [100, -1, -2000])
def test_one_flipped_bit_is_seen(cli: Hil, signed: Path, at: int) -> None:
    data = bytearray(signed.read_bytes())
    data[at] ^= 1
    signed.write_bytes(data)
    status, reported = check(cli)
    assert status == 1 and "l.mcap: its bytes are not those that were signed" in reported


def test_a_cut_log_and_a_mended_one_are_seen(cli: Hil, signed: Path) -> None:
    whole = signed.read_bytes()
    signed.write_bytes(whole[:-100])
    status, reported = check(cli)
    assert status == 1 and f"l.mcap: has {len(whole) - 100} bytes, {len(whole)} were signed" in reported
    recover(signed, signed.with_name("r.mcap"))
    status, reported = check(cli, log="r.mcap")
    assert status == 2 and "r.mcap: is not signed: there is no r.mcap.sig beside it" in reported
    shutil.copy("l.mcap.sig", "r.mcap.sig")
    assert check(cli, log="r.mcap")[0] == 1


def test_another_key_and_a_changed_signature_are_named(cli: Hil, signed: Path) -> None:
    cli("keys", "signing", "other")
    status, reported = check(cli, key="other/signing.pub")
    assert status == 1 and "was signed with the key 'SHA256:" in reported and "not with other/signing.pub" in reported
    text = Path("l.mcap.sig").read_text()
    for old, new, said in (
        ('"bytes": ', '"bytes": 1', "the signature is not that of k/signing.pub: it was changed"),
        ('"signature": "', '"signature": "AAAA', "it was changed"), ("{", "[", "is no signature of a log"),
        ('"sha256": "', '"sha256": "0', "it was changed"),
    ):  # fmt: skip
        Path("l.mcap.sig").write_text(text.replace(old, new, 1))
        status, reported = check(cli)
        assert status == 1 and said in reported, reported


def test_a_forger_who_recomputes_the_digest_has_no_key(cli: Hil, signed: Path) -> None:
    """Another log with its own true digest, signed by the forger, under the name of the true key."""
    cli("keys", "signing", "forger")
    assert cli("run", "dc-motor-hinf", "--duration", "1", "--seed", "5", "-o", "f.mcap", "--sign", "forger/signing.key")[0] == 0
    true, forged = Path("l.mcap.sig").read_text(), Path("f.mcap.sig").read_text()
    name, other = (next(line for line in text.splitlines() if '"key"' in line) for text in (true, forged))
    Path("f.mcap.sig").write_text(forged.replace(other, name))
    status, reported = check(cli, log="f.mcap")
    assert status == 1 and "the signature is not that of k/signing.pub" in reported


def test_what_is_no_key_is_refused_before_anything_runs(cli: Hil, signed: Path) -> None:
    Path("frames.key").write_text("00\n")
    Path("frames.key").chmod(0o600)
    Path("open.key").write_bytes(Path("k/signing.key").read_bytes())
    Path("open.key").chmod(0o644)
    for key, said in (("frames.key", "is no private key"), ("open.key", "other users can read it"), ("none", "cannot be read")):
        status, _, err = cli("run", "dc-motor-hinf", "--duration", "1", "-o", "n.mcap", "--sign", key)
        assert status == 2 and said in err and not Path("n.mcap").exists(), err
    assert check(cli, key="frames.key")[0] == 2 and check(cli, key="k/signing.key")[0] == 2
    other = ec.generate_private_key(ec.SECP256R1()).public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)
    Path("other.pub").write_bytes(other)
    assert "other.pub: is no Ed25519 key; expected the signing.pub" in check(cli, key="other.pub")[1]
    status, _, err = cli("keys", "signing", "k")
    assert status == 2 and "has a signing key already" in err


@pytest.mark.parametrize("size", ["1e400", "NaN", "true", "null", "15334.5", '"1"', "[1]"])
def test_a_length_that_is_no_whole_number_is_no_signature(cli: Hil, signed: Path, size: str) -> None:
    signature = signed.with_name("l.mcap.sig")
    signature.write_text(re.sub('"bytes": [0-9]+', f'"bytes": {size}', signature.read_text()))
    status, reported = check(cli)
    assert status == 1 and "l.mcap.sig: is no signature of a log" in reported


def test_what_cannot_be_signed_is_refused_before_the_run(cli: Hil, signed: Path) -> None:
    status, out, err = cli("run", "dc-motor-hinf", "--duration", "1", "-o", "/dev/null", "--force", "--sign", "k/signing.key")
    assert status == 2 and "--sign: /dev/null is no regular file" in err and not out
