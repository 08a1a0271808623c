"""Who may speak over zenoh: the certificate called controller, the user called controller, and no other."""

from __future__ import annotations

import os
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import zenoh

from hil.files.keys import make_keys
from tests.ports import free_port
from tests.waiting import until
from transport import Link, TransportError, open_link
from transport.links.contract import control, expect, meet, sensor
from transport.links.zenoh_link import config, zenoh_directory


@pytest.fixture
def keys(tmp_path: Path) -> Path:
    make_keys(tmp_path / "keys")
    return tmp_path / "keys"


@pytest.fixture
def users(tmp_path: Path) -> Path:
    path = tmp_path / "users"
    path.write_text("controller:letmein\nobserver:look\n")
    path.chmod(0o600)
    return path


def both_directions_work(rig: Link, controller: Link) -> None:
    meet(rig, controller)
    rig.send(sensor(1))
    controller.send(control(1))
    expect(controller, sensor(1))
    expect(rig, control(1))


def test_certificates_of_one_authority_let_both_ends_receive_from_each_other(keys: Path) -> None:
    uri = f"zenoh:tls/127.0.0.1:{free_port()}?keys={keys}"
    with open_link(uri, "rig") as rig, open_link(uri, "controller") as controller:
        both_directions_work(rig, controller)
        assert rig.counters.refused == controller.counters.refused == 0


def test_each_end_may_have_only_its_own_key(keys: Path, tmp_path: Path) -> None:
    port, uris = free_port(), {}
    for role in ("rig", "controller"):
        own = tmp_path / role
        own.mkdir()
        for name in ("ca.pem", f"{role}.pem", f"{role}.key"):
            shutil.copy2(keys / name, own)
        uris[role] = f"zenoh:tls/127.0.0.1:{port}?ca={own}/ca.pem&cert={own}/{role}.pem&key={own}/{role}.key"
    with open_link(uris["rig"], "rig") as rig, open_link(uris["controller"], "controller") as controller:
        both_directions_work(rig, controller)


@contextmanager
def zenoh_intruder(port: int, entries: dict[str, Any], protocol: str = "tls") -> Iterator[tuple[zenoh.Session, list[bytes]]]:
    """A zenoh program without any list of its own, that writes both keys and reads both."""
    entries.pop("access_control", None)
    received: list[bytes] = []
    with zenoh.open(config("controller", f"{protocol}/127.0.0.1:{port}", entries)) as session:
        for key in ("hil/**", "hil/rig0/sensor"):
            took = zenoh.handlers.Callback(lambda sample: received.append(sample.payload.to_bytes()), indirect=False)
            session.declare_subscriber(key, took, allowed_origin=zenoh.Locality.REMOTE)  # not what it says itself
        yield session, received


def tls_entries(keys: Path, name: str) -> dict[str, Any]:
    at = "transport/link/tls"
    return {
        f"{at}/root_ca_certificate": str(keys / "ca.pem"), f"{at}/enable_mtls": True,
        f"{at}/connect_certificate": str(keys / f"{name}.pem"), f"{at}/connect_private_key": str(keys / f"{name}.key"),
    }  # fmt: skip


def speak(session: zenoh.Session, rig: Link, controller: Link, times: int = 20) -> list[bytes]:
    """Write both keys as the intruder; return what the rig and the controller received that is not theirs."""
    strange = []
    for seq in range(1, times + 1):
        session.put("hil/rig0/control", control(1000 + seq))
        session.put("hil/rig0/sensor", sensor(1000 + seq))
        rig.send(sensor(seq))
        controller.send(control(seq))
        for link, expected in ((rig, control(seq)), (controller, sensor(seq))):
            while (got := link.receive(2.0)) is not None and got != expected:
                strange.append(got)
            assert got == expected
    return strange


def test_another_name_of_the_same_authority_is_refused_and_counted(keys: Path) -> None:
    port = free_port()
    uri = f"zenoh:tls/127.0.0.1:{port}?keys={keys}"
    with open_link(uri, "rig") as rig, open_link(uri, "controller") as controller:
        meet(rig, controller)
        with zenoh_intruder(port, tls_entries(keys, "rig")) as (session, received):  # a good certificate, not the controller's
            until(lambda: rig.counters.refused > 0, "the intruder")
            assert speak(session, rig, controller) == [] and received == []
        assert rig.counters.refused == 1


def test_another_authority_and_no_certificate_never_connect(keys: Path, tmp_path: Path) -> None:
    port = free_port()
    make_keys(tmp_path / "others")
    uri = f"zenoh:tls/127.0.0.1:{port}?keys={keys}"
    with open_link(uri, "rig") as rig, open_link(uri, "controller") as controller:
        meet(rig, controller)
        bare = {"transport/link/tls/root_ca_certificate": str(keys / "ca.pem")}
        for entries in (tls_entries(tmp_path / "others", "controller"), bare):
            with zenoh_intruder(port, entries) as (session, received):
                assert speak(session, rig, controller) == [] and received == []
                assert not [*session.info.peers_zid()]


def test_a_password_lets_the_controller_in_and_no_other(users: Path) -> None:
    port = free_port()
    uri = f"zenoh:tcp/127.0.0.1:{port}?users={users}"
    with open_link(uri, "rig") as rig, open_link(uri, "controller") as controller:
        both_directions_work(rig, controller)
        for login in (None, {"user": "controller", "password": "guess"}, {"user": "observer", "password": "look"}):
            entries = {} if login is None else {"transport/auth/usrpwd": login}
            with zenoh_intruder(port, entries, "tcp") as (session, received):
                assert speak(session, rig, controller, 10) == [] and received == []


def test_a_secret_that_others_may_read_is_refused(keys: Path, users: Path) -> None:
    (keys / "rig.key").chmod(0o644)
    with pytest.raises(TransportError, match=r"other users can read it \(mode 644\); chmod 600 it"):
        open_link(f"zenoh:tls/127.0.0.1:{free_port()}?keys={keys}", "rig")
    users.chmod(0o640)
    with pytest.raises(TransportError, match=r"other users can read it \(mode 640\)"):
        open_link(f"zenoh:tcp/127.0.0.1:{free_port()}?users={users}", "rig")


def test_a_bare_uri_is_a_socket_in_a_directory_of_our_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HIL_ZENOH_DIR", str(tmp_path / "z"))
    with open_link("zenoh:", "rig") as rig, open_link("zenoh:", "controller") as controller:
        both_directions_work(rig, controller)
        assert stat.S_IMODE(zenoh_directory().stat().st_mode) == 0o700
        assert any(path.is_socket() for path in zenoh_directory().iterdir())
        with pytest.raises(TransportError, match="is another rig running there"):
            open_link("zenoh:", "rig")
        with open_link("zenoh:?name=rig1", "rig"):  # beside it
            pass
    os.chmod(tmp_path / "z", 0o755)
    with pytest.raises(TransportError, match="mode 700"):
        open_link("zenoh:", "rig")
