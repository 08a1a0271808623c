"""A name that is revoked is let in no more: refused at both ends by a sentence, kept silent where its old key connects."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from click.testing import CliRunner

from hil.cli import doctor, one_end
from hil.errors import HilError
from hil.files.keys import issue_certificate, make_keys, renew_certificates, revoke_names
from tests.links.test_zenoh_access import both_directions_work, speak, tls_entries, zenoh_intruder
from tests.links.test_zenoh_refusals import rig_of
from tests.ports import free_port
from tests.waiting import until
from transport import TransportError, open_link
from transport.links.contract import meet


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    make_keys(tmp_path / "keys")
    return tmp_path / "keys"


def hil_keys(*words: object) -> str:
    done = CliRunner().invoke(one_end.keys, [str(word) for word in words], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.output


def test_a_revoked_name_is_refused_at_both_ends_and_another_one_takes_its_place(folder: Path) -> None:
    uri = f"zenoh:tls/127.0.0.1:{free_port()}?keys={folder}"
    assert hil_keys("revoke", folder, "controller") == f"{folder}/revoked\n"
    for role in ("rig", "controller"):
        with pytest.raises(TransportError, match=r"^link .*/revoked: the name controller is revoked; `hil keys issue DIR NAME`"):
            open_link(uri, role)
    fine, finding, _ = doctor._certificates(doctor._certificates_of(uri))
    assert not fine and "the name controller is revoked" in finding
    hil_keys("issue", folder, "bench2")
    assert (folder / "bench2.key").stat().st_mode & 0o777 == 0o600
    with open_link(f"{uri}&controller=bench2", "rig") as rig, open_link(f"{uri}&controller=bench2", "controller") as controller:
        both_directions_work(rig, controller)
    assert doctor._certificates(doctor._certificates_of(f"{uri}&controller=bench2"))[0]


def test_a_name_that_no_certificate_has_is_said_when_it_is_revoked(folder: Path) -> None:
    """A misspelt name would leave the right one in."""
    done = CliRunner().invoke(one_end.keys, ["revoke", str(folder), "controler"])
    assert done.exit_code == 0 and (folder / "revoked").read_text() == "controler\n"
    said = "holds no certificate of 'controler', which is on the list now; did you mean 'controller'?\n"
    assert done.stderr == f"hil: {folder} {said}"


def test_the_old_key_of_a_revoked_name_connects_and_is_kept_silent_counted_and_said(folder: Path) -> None:
    hil_keys("issue", folder, "bench2")
    hil_keys("revoke", folder, "controller")
    port = free_port()
    uri = f"zenoh:tls/127.0.0.1:{port}?keys={folder}&controller=bench2"
    with open_link(uri, "rig") as rig, open_link(uri, "controller") as controller:
        meet(rig, controller)
        with zenoh_intruder(port, tls_entries(folder, "controller")) as (session, received):
            until(lambda: rig.counters.refused > 0, "the old key")
            assert speak(session, rig, controller) == [] and received == []
    reasons: list[str] = []
    with rig_of(uri, reasons) as refused, zenoh_intruder(port, tls_entries(folder, "controller")):
        until(lambda: refused() > 0 and bool(reasons), "the old key")
    assert reasons[0] == "hil: zenoh refused a connection: the certificate is called 'controller', a name that is revoked\n"


def test_no_certificate_is_issued_for_a_revoked_name_or_one_that_is_there(folder: Path) -> None:
    revoke_names(folder, ["bench2", "bench3"])
    revoke_names(folder, ["bench2"])
    assert (folder / "revoked").read_text() == "bench2\nbench3\n"
    with pytest.raises(HilError, match="the name bench2 is revoked; choose another one"):
        issue_certificate(folder, "bench2")
    with pytest.raises(HilError, match=r"rig\.pem: cannot be written: File exists"):
        issue_certificate(folder, "rig")
    for name in ("../x", "ca", "", "a/b", "x" * 65, "a\nb"):
        with pytest.raises(HilError, match="expected up to 64 letters"):
            issue_certificate(folder, name)
    with pytest.raises(HilError, match="expected up to 64 letters"):
        revoke_names(folder, ["fine", "a\nb"])
    assert "fine" not in (folder / "revoked").read_text() and not (folder / "bench2.pem").exists()
    for none in ("none", "m" * 300, "a\0b"):
        with pytest.raises(HilError, match=r"ca.pem: no such file"):
            revoke_names(folder / none, ["x"])
    assert [path.name for path in renew_certificates(folder)] == ["ca.pem", "controller.pem", "rig.pem"]


@pytest.mark.parametrize("kind", ["pipe", "folder", "bytes", "large"])
def test_a_list_that_is_none_opens_no_link(folder: Path, kind: str) -> None:
    """Who cannot read the list does not know whom to refuse."""
    path = folder / "revoked"
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    else:
        path.write_bytes(b"\xff\xfe" if kind == "bytes" else b"a\n" * 600_000)
    for role in ("rig", "controller"):
        with pytest.raises(TransportError, match="a list of revoked names"):
            open_link(f"zenoh:tls/127.0.0.1:{free_port()}?keys={folder}", role)
