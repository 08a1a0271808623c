"""A role on a link belongs to one process of one user; another user cannot hold it, and a killed holder's is free."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from hashlib import sha256
from pathlib import Path
from types import SimpleNamespace

import pytest

from transport import TransportError, open_link
from transport.links import private_directory
from transport.links.can_bus import bus_directory
from transport.links.private_directory import Claim, locked

HOLD = """
import sys
from transport.links.private_directory import Claim
with Claim("can:hil:x", "rig", "here", choose="another"):
    print("held", flush=True)
    sys.stdin.read()
"""


@pytest.fixture(autouse=True)
def claims(tmp_path: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("HIL_CLAIM_DIR", str(tmp_path / "claims"))
    monkeypatch.setenv("HIL_CAN_DIR", str(tmp_path_factory.mktemp("c")))  # short: a socket's path has at most 107 bytes
    return tmp_path / "claims"


def take() -> Claim:
    return Claim("can:hil:x", "rig", "here", choose="another channel")


def test_a_claim_is_one_processes_and_goes_with_it_however_it_ends(claims: Path) -> None:
    with subprocess.Popen([sys.executable, "-c", HOLD], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as holder:
        assert holder.stdout is not None and holder.stdout.readline() == b"held\n"
        with pytest.raises(TransportError, match=r"is another rig running there\? Stop it, or choose another channel"):
            take()
        Claim("can:hil:x", "controller", "here", choose="").close()
        Claim("can:hil:x", "rig", "there", choose="").close()
        holder.kill()
        holder.wait()
    with take() as claim:
        claim.close()
    assert not any(claims.iterdir())


def test_a_claim_is_a_file_that_no_other_user_reaches(claims: Path) -> None:
    """An abstract Unix name has no owner: who bound it first, whoever that was, kept the channel from its user."""
    where = ("hil", bus_directory(), ("mine", 0x140))
    name = sha256(repr(where).encode()).hexdigest()
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as squatter:
        squatter.bind(f"\0hilrig-{os.geteuid()}-{name}")  # what a user of another number did
        with open_link("can:hil:mine", "rig"):
            assert claims.stat().st_mode & 0o777 == 0o700
            assert all(path.stat().st_mode & 0o777 == 0o600 for path in claims.iterdir())
            bound = Path("/proc/net/unix").read_text()
            assert bound.count(f"@hilrig-{os.geteuid()}-") == bound.count(f"@hilrig-{os.geteuid()}-{name}") == 1


def test_a_directory_that_others_may_enter_or_that_is_a_link_is_refused(claims: Path, tmp_path: Path) -> None:
    claims.mkdir(mode=0o755)
    with pytest.raises(TransportError, match=r"claims: must be a directory of user.*HIL_CLAIM_DIR"):
        take()
    claims.rmdir()
    (tmp_path / "elsewhere").mkdir(mode=0o700)
    claims.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(TransportError, match="claims"):
        take()
    assert not any((tmp_path / "elsewhere").iterdir())


def test_a_file_of_a_claim_that_is_a_symbolic_link_is_not_followed(claims: Path, tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    with take():
        (path,) = claims.iterdir()
    path.symlink_to(victim)
    with pytest.raises(TransportError):
        take()
    assert not victim.exists()


def test_a_lock_is_waited_for_in_pauses_of_10_ms_for_as_long_as_is_asked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pauses: list[int] = []
    monkeypatch.setattr(private_directory, "select", SimpleNamespace(poll=lambda: SimpleNamespace(poll=pauses.append)))
    lock = tmp_path / "mine" / "lock"
    with locked(lock, 1.0):
        with pytest.raises(TransportError, match="lock: locked for 20 s by a process that is stopped"), locked(lock, 20.0):
            pass
        assert pauses == 2000 * [10]
        with locked(tmp_path / "mine" / "other", 0.0):  # of that directory alone, and tried once at least
            pass
    with locked(lock, 0.0):
        pass
    assert len(pauses) == 2000
