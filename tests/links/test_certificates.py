"""A certificate that the other end would refuse is refused here, with the reason, before anything is opened."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from click.testing import CliRunner
from cryptography.x509 import load_pem_x509_certificates

from hil.cli import doctor, one_end
from hil.errors import HilError
from hil.files.keys import make_keys, renew_certificates
from tests.ports import free_port
from transport import TransportError, open_link
from transport.links.authentication import check_certificate


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    make_keys(tmp_path / "keys", ["rig.lab"], days=2)
    return tmp_path / "keys"


def check(folder: Path, role: str = "controller", days: float = 0.0, name: str | None = None) -> datetime:
    return check_certificate(f"{folder}/ca.pem", f"{folder}/{role}.pem", name or role, datetime.now(UTC) + timedelta(days=days))


@pytest.mark.parametrize("role", ["rig", "controller"])
def test_what_the_other_end_would_refuse_says_why(folder: Path, tmp_path: Path, role: str) -> None:
    assert timedelta(days=1) < check(folder, role) - datetime.now(UTC) < timedelta(days=2)
    with pytest.raises(TransportError, match=f"{role}.pem: the certificate expired on 20.*hil keys renew DIR"):
        check(folder, role, days=3)
    with pytest.raises(TransportError, match=f"{role}.pem: the certificate is not yet valid, but from 20"):
        check(folder, role, days=-1)
    with pytest.raises(TransportError, match=f"{role}.pem: is called {role}, the other end lets in only alice"):
        check(folder, role, name="alice")
    files = f"{folder}/ca.pem", f"{folder}/{role}.pem", role
    for end in ("not_valid_before_utc", "not_valid_after_utc"):  # in time are both ends of its time
        (own,) = load_pem_x509_certificates((folder / f"{role}.pem").read_bytes())[:1]
        check_certificate(*files, getattr(own, end))
    make_keys(tmp_path / "other")
    shutil.copy(tmp_path / "other/ca.pem", folder)
    with pytest.raises(TransportError, match=f"{role}.pem: is a certificate of another authority than .*ca.pem"):
        check(folder, role)


def expire(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Make the certificates in a folder as if three days ago; they are good for two."""
    import hil.files.keys as renewal

    class Earlier(datetime):
        @classmethod
        def now(cls, tz: object = None) -> datetime:
            return datetime.now(UTC) - timedelta(days=3)

    with monkeypatch.context() as patched:
        patched.setattr(renewal, "datetime", Earlier)
        renew_certificates(folder, days=2)


def test_an_expired_end_is_refused_at_once_doctor_sees_it_and_renewal_mends_it(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    uri = f"zenoh:tls/127.0.0.1:{free_port()}?keys={folder}"
    see: Callable[[], tuple[bool, str, str]] = lambda: doctor._certificates(doctor._certificates_of(uri))  # noqa: E731
    assert see()[0] and "rig until 20" in see()[1] and "controller until 20" in see()[1]
    secret = (folder / "controller.key").read_bytes()
    expire(folder, monkeypatch)
    for role in ("rig", "controller"):
        with pytest.raises(TransportError, match=f"link .*{role}.pem: the certificate expired on"):
            open_link(uri, role)
    assert not see()[0] and "expired on" in see()[1]
    done = CliRunner().invoke(one_end.keys, ["renew", str(folder), "--days", "9"])
    assert done.exit_code == 0 and len(done.output.splitlines()) == 3
    assert see()[0] and (folder / "controller.key").read_bytes() == secret
    with open_link(uri, "rig"), open_link(uri, "controller"):
        pass


CONTROLLER = """
import sys
from transport.links.zenoh_refusals import standard_output_is_free
standard_output_is_free()
from transport import open_link
with open_link(sys.argv[1], "controller"):
    sys.stdin.read()
"""


def test_a_controller_whose_rig_is_of_another_authority_says_so(folder: Path, tmp_path: Path) -> None:
    make_keys(tmp_path / "other")
    at = f"zenoh:tls/127.0.0.1:{free_port()}?keys="
    command = [sys.executable, "-c", CONTROLLER, f"{at}{tmp_path}/other"]
    with (
        open_link(f"{at}{folder}", "rig"),
        subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process,
    ):
        assert process.stdin is not None and process.stderr is not None
        said = process.stderr.readline()
        whole = said if said.startswith("hil:") else said + process.stderr.read()  # what failed in it, to its end
        assert whole == "hil: zenoh refused a connection: a certificate is of another authority\n"
        process.stdin.close()


def test_renewal_needs_the_key_of_the_authority_and_replaces_nothing_without_it(folder: Path, tmp_path: Path) -> None:
    before = {path: path.read_bytes() for path in folder.iterdir()}
    make_keys(tmp_path / "other")
    shutil.copy(tmp_path / "other/ca.key", folder)
    with pytest.raises(HilError, match=r"ca.pem: is not the certificate of"):
        renew_certificates(folder)
    (folder / "ca.key").unlink()
    with pytest.raises(HilError, match=r"ca.key: .*renewed where the authority's key is kept"):
        renew_certificates(folder)
    assert all(path.read_bytes() == data for path, data in before.items() if path.name != "ca.key")


@pytest.mark.parametrize("kind", ["pipe", "device", "folder", "long", "bytes"])
@pytest.mark.parametrize("name", ["ca.pem", "rig.pem"])
def test_what_is_no_certificate_is_refused_and_never_waited_for(folder: Path, name: str, kind: str) -> None:
    """A check of `hil doctor` waited for a pipe without end, and took all memory for a device."""
    path = folder / name
    path.unlink()
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "device":
        path.symlink_to("/dev/zero")
    elif kind == "folder":
        path.mkdir()
    else:
        path.write_bytes(b"\xff" * (2 << 20) if kind == "long" else b"\xff\0")
    uri = f"zenoh:tls/127.0.0.1:{free_port()}?keys={folder}"
    ok, said, _ = doctor._certificates(doctor._certificates_of(uri))
    assert not ok and name in said
    with pytest.raises(TransportError, match=f"link .*{name}"):
        open_link(uri, "rig")
    with pytest.raises(HilError, match=name):
        renew_certificates(folder)


def test_a_key_of_the_authority_that_is_none_names_its_file(folder: Path) -> None:
    (folder / "ca.key").write_text("no key")
    with pytest.raises(HilError, match=r"ca\.key: is no private key in PEM"):
        renew_certificates(folder)
