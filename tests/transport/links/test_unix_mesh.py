"""What the mesh does where the bus's tests do not look: waiting, locking, and datagrams that are none."""

from __future__ import annotations

import fcntl
import os
import select
import socket
import tempfile
from collections.abc import Iterator
from pathlib import Path
from time import monotonic
from typing import Any

import pytest

from transport import TransportError
from transport.links.unix_mesh import HEAD, LOOKS, Mesh


@pytest.fixture
def directory() -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix="hil-test-") as path:
        yield Path(path) / "mesh"


class CountingEpoll:
    """The real epoll, and how often it was asked without waiting."""

    def __init__(self, epoll: select.epoll) -> None:
        self._epoll, self.looks = epoll, 0

    def poll(self, timeout: float | None = None) -> list[tuple[int, int]]:
        self.looks += timeout == 0
        return self._epoll.poll(timeout)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._epoll, name)


def test_a_short_wait_looks_before_it_sleeps_and_gives_that_up_where_it_never_helps(directory: Path) -> None:
    with Mesh(directory) as sender, Mesh(directory) as listener:
        sender.send(HEAD.pack(0.0, 0))
        counting = CountingEpoll(listener._epoll)
        listener._epoll = counting  # type: ignore[assignment]
        assert listener.receive(0.01) is not None and counting.looks == 1
        for _ in range(200):
            assert listener.receive(0.00001) is None
        assert counting.looks <= 10 * LOOKS
        sender.send(HEAD.pack(0.0, 0))
        assert listener.receive(0.01) is not None


@pytest.mark.parametrize("timeout_s", [0.0007, 0.003, 0.06])
def test_a_wait_is_as_long_as_was_said(timeout_s: float, directory: Path) -> None:
    with Mesh(directory) as mesh:
        for _ in range(10):  # beyond the looks in vain
            begin = monotonic()
            assert mesh.receive(timeout_s) is None
            assert monotonic() - begin >= 0.95 * timeout_s
        assert mesh.receive(0) is None


def test_a_datagram_too_short_to_be_one_is_passed_over(directory: Path) -> None:
    with Mesh(directory) as mesh, socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as stranger, Mesh(directory) as friend:
        stranger.connect(str(mesh._path))
        stranger.send(b"hello")
        friend.send(HEAD.pack(1.0, 0) + b"frame")
        assert mesh.receive(1) == HEAD.pack(1.0, 0) + b"frame"
        stranger.close()
        assert mesh.receive(0.01) is None
        friend.send(HEAD.pack(2.0, 0))
        mesh.send(HEAD.pack(3.0, 0))
        assert mesh.participants == 2


def test_who_cannot_get_the_lock_says_that_somebody_stopped_in_mid_join(
    directory: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("transport.links.unix_mesh._JOIN_TIMEOUT_S", 0.05)
    held = os.open(directory.parent, os.O_RDONLY)
    fcntl.flock(held, fcntl.LOCK_EX)
    with pytest.raises(TransportError, match="stopped while it joins"):
        Mesh(directory)
    os.close(held)
    Mesh(directory).close()


def test_a_directory_that_is_a_link_is_refused(directory: Path, tmp_path: Path) -> None:
    trap = tmp_path / "trap"
    trap.symlink_to(directory.parent)
    with pytest.raises(TransportError, match="trap"):
        Mesh(trap / "mesh")


def test_participants_number_themselves_and_leave_no_descriptor_open(directory: Path) -> None:
    before = len(os.listdir("/proc/self/fd"))
    meshes = [Mesh(directory, echo=number == 3) for number in range(10)]
    for mesh in meshes:
        mesh.send(HEAD.pack(0.0, 0))
    assert all(mesh.participants == 10 for mesh in meshes)
    for mesh in meshes:
        mesh.close()
        mesh.close()
        assert mesh.fileno() == -1
    assert len(os.listdir("/proc/self/fd")) == before and not directory.exists()


def test_who_missed_more_than_one_datagram_can_tell_is_told_by_the_next_ones(directory: Path) -> None:
    with Mesh(directory) as sender, Mesh(directory) as listener:
        sender.send(HEAD.pack(0.0, 0))
        sender._peers[0].missed = 0x1_2345
        for _ in range(3):
            sender.send(HEAD.pack(0.0, 0))
        while listener.receive(0.01) is not None:
            pass
        assert listener.lost == 0x1_2345


def test_a_directory_open_to_others_is_refused_with_the_remedy(directory: Path) -> None:
    directory.parent.chmod(0o755)
    with pytest.raises(TransportError, match="with mode 700; chmod 700 it, or choose another directory"):
        Mesh(directory)
