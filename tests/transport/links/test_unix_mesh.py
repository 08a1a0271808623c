"""What the mesh does where the bus's tests do not look: waiting, locking, and datagrams that are none."""

from __future__ import annotations

import fcntl
import os
import resource
import select
import socket
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from threading import Event, Thread
from time import monotonic
from typing import Any

import pytest

from tests.file_limit import files_up_to
from tests.waiting import LIMIT_S
from transport import TransportError
from transport.links.mesh_members import HEAD
from transport.links.unix_mesh import POLLS, QUEUE_LIMIT, Mesh


@pytest.fixture
def directory() -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix="hil-test-") as path:
        yield Path(path) / "mesh"


class CountingEpoll:
    """The real epoll, and how often it was asked without waiting."""

    def __init__(self, epoll: select.epoll) -> None:
        self._epoll, self.polls = epoll, 0

    def poll(self, timeout: float | None = None) -> list[tuple[int, int]]:
        self.polls += timeout == 0
        return self._epoll.poll(timeout)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._epoll, name)


def test_a_short_wait_looks_before_it_sleeps_and_gives_that_up_where_it_never_helps(directory: Path) -> None:
    with Mesh(directory) as sender, Mesh(directory) as listener:
        sender.send(HEAD.pack(0.0, 0))
        counting = CountingEpoll(listener._members.epoll)
        listener._members.epoll = counting  # type: ignore[assignment]
        assert listener.receive(0.01) is not None and counting.polls == 1
        for _ in range(200):
            assert listener.receive(0.00001) is None
        assert counting.polls <= 10 * POLLS
        sender.send(HEAD.pack(0.0, 0))
        assert listener.receive(0.01) is not None


def test_a_participant_let_in_by_another_thread_gets_what_is_sent(directory: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A bus with time sends from a thread of its own, while its program reads: each sees that a newcomer has joined."""
    accept, lets_in, go_on = socket.socket.accept, Event(), Event()

    def slow(listener: socket.socket) -> tuple[socket.socket, Any]:
        lets_in.set()
        assert go_on.wait(LIMIT_S)
        return accept(listener)

    with Mesh(directory) as sender, Mesh(directory) as newcomer:
        monkeypatch.setattr(socket.socket, "accept", slow)
        reads = Thread(target=sender.receive, args=(0.5,))
        reads.start()
        assert lets_in.wait(LIMIT_S)
        sends = Thread(target=sender.send, args=(HEAD.pack(0.0, 0),))
        sends.start()
        sends.join(0.2)  # it has to wait for the other thread; where it does not, it is over by now
        go_on.set()
        sends.join()
        reads.join()
        assert newcomer.receive(0.01) is not None


def test_leaving_while_another_thread_sends_raises_no_error_there(directory: Path) -> None:
    with Mesh(directory) as sender, Mesh(directory) as listener:
        sender.close()
        assert sender.send(HEAD.pack(0.0, 0)) and listener.receive(0.01) is None


def test_a_participant_that_joined_before_a_datagram_was_sent_receives_it_once(directory: Path) -> None:
    with Mesh(directory) as sender, Mesh(directory) as there:
        assert sender.send(HEAD.pack(0.0, 0)) and sender.participants == 2
        with Mesh(directory) as newcomer:
            assert sender.send(HEAD.pack(1.0, 0)) and sender.participants == 3
            assert [there.receive(0), there.receive(0), there.receive(0)] == [HEAD.pack(0.0, 0), HEAD.pack(1.0, 0), None]
            assert [newcomer.receive(0), newcomer.receive(0)] == [HEAD.pack(1.0, 0), None]


@pytest.mark.parametrize("timeout_s", [0.0007, 0.003, 0.06])
def test_a_wait_is_as_long_as_was_said(timeout_s: float, directory: Path) -> None:
    with Mesh(directory) as mesh:
        for _ in range(10):  # beyond the looks in vain
            begin = monotonic()
            assert mesh.receive(timeout_s) is None
            assert monotonic() - begin >= 0.95 * timeout_s
        assert mesh.receive(0) is None


def test_a_participant_that_waits_for_one_other_receives_a_newcomer_too(directory: Path) -> None:
    expected = [HEAD.pack(float(number), 0) for number in range(3)]
    found: list[bytes | None] = []

    def read() -> None:
        limit = monotonic() + LIMIT_S
        while [each for each in found if each] != expected and monotonic() < limit:
            found.append(listener.receive(LIMIT_S))  # None comes early, too: someone has joined

    with Mesh(directory) as listener, Mesh(directory):
        assert listener.receive(0) is None and listener.participants == 2
        reads = Thread(target=read)
        reads.start()
        with Mesh(directory) as newcomer:
            for datagram in expected:
                newcomer.send(datagram)
            reads.join()
        assert [each for each in found if each] == expected


def test_a_participant_that_has_sent_receives_a_newcomer_beside_one_that_never_pauses(directory: Path) -> None:
    with Mesh(directory) as talker, Mesh(directory) as listener:
        talker.send(HEAD.pack(0.0, 0))
        assert listener.receive(0) is not None and listener.send(HEAD.pack(0.0, 0))
        with Mesh(directory) as newcomer:
            newcomer.send(HEAD.pack(1.0, 0) + b"new")
            found = []
            for _ in range(4):
                talker.send(HEAD.pack(0.0, 0) + b"old")
                found.append(listener.receive(0.01))
    assert HEAD.pack(1.0, 0) + b"new" in found


def test_a_sleep_for_a_lone_participant_ends_when_it_leaves(directory: Path) -> None:
    with Mesh(directory) as listener:
        other = Mesh(directory)
        assert listener.receive(0) is None and listener.participants == 2
        begun = monotonic()
        leaves = Thread(target=other.close)
        leaves.start()
        assert listener.receive(LIMIT_S) is None
        leaves.join()
        assert monotonic() - begun < LIMIT_S / 2 and listener.participants == 1


def test_a_datagram_too_short_to_be_one_is_passed_over(directory: Path) -> None:
    with Mesh(directory) as mesh, socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as stranger, Mesh(directory) as friend:
        stranger.connect(str(mesh._members._path))
        stranger.send(b"hello")
        friend.send(HEAD.pack(1.0, 0) + b"frame")
        assert mesh.receive(1) == HEAD.pack(1.0, 0) + b"frame"
        stranger.close()
        assert mesh.receive(0.01) is None
        friend.send(HEAD.pack(2.0, 0))
        mesh.send(HEAD.pack(3.0, 0))
        assert mesh.participants == 2


def test_a_lock_that_is_not_free_is_reported_as_a_process_stopped_in_mid_join(
    directory: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("transport.links.mesh_members._JOIN_TIMEOUT_S", 0.05)
    directory.mkdir(mode=0o700)
    held = os.open(directory, os.O_RDONLY)
    fcntl.flock(held, fcntl.LOCK_EX)
    with pytest.raises(TransportError, match=r"mesh: locked for .* stopped while it joins; .* choose another channel"):
        Mesh(directory)
    Mesh(directory.parent / "other").close()  # one channel bars no other
    os.close(held)
    Mesh(directory).close()


def test_a_lock_on_all_channels_bars_none(directory: Path) -> None:
    held = os.open(directory.parent, os.O_RDONLY)
    fcntl.flock(held, fcntl.LOCK_EX)
    with Mesh(directory), Mesh(directory):
        pass
    os.close(held)


@pytest.fixture
def few_descriptors() -> Iterator[None]:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    yield
    resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


@pytest.mark.usefixtures("few_descriptors")
def test_without_a_free_descriptor_no_process_spins_and_a_joining_one_waits(directory: Path) -> None:
    with Mesh(directory) as mesh, Mesh(directory) as first, socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as newcomer:
        assert mesh.receive(0) is None and mesh.participants == 2  # the first one is in
        newcomer.connect(str(mesh._members._path))
        _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        lowest_free = os.dup(0)
        os.close(lowest_free)
        resource.setrlimit(resource.RLIMIT_NOFILE, (lowest_free, hard))
        counting = CountingEpoll(mesh._members.epoll)
        mesh._members.epoll = counting  # type: ignore[assignment]
        assert mesh.receive(0) is None and mesh.refused == 1
        for _ in range(20):
            assert mesh.receive(0) is None
        assert counting.polls <= 22 and mesh.refused == 1  # it looped for ever
        first.send(HEAD.pack(1.0, 0) + b"frame")
        assert mesh.receive(0) == HEAD.pack(1.0, 0) + b"frame"  # and hears the others
        first.close()
        while not mesh._members._listening:  # until it has seen that the first one left
            assert mesh.receive(0.01) is None
        newcomer.send(HEAD.pack(2.0, 0) + b"hello")
        assert mesh.receive(1) == HEAD.pack(2.0, 0) + b"hello"


@pytest.mark.usefixtures("few_descriptors")
def test_joining_without_a_free_descriptor_is_refused_and_leaves_none_open(directory: Path) -> None:
    with Mesh(directory):
        before = len(os.listdir("/proc/self/fd"))
        _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        lowest_free = os.dup(0)
        os.close(lowest_free)
        for more in range(7):
            resource.setrlimit(resource.RLIMIT_NOFILE, (lowest_free + more, hard))
            with pytest.raises(TransportError, match="Too many open files"):
                Mesh(directory, echo=True)
        resource.setrlimit(resource.RLIMIT_NOFILE, (before + 50, hard))
        assert len(os.listdir("/proc/self/fd")) == before


def test_a_mark_that_was_cut_costs_no_life(directory: Path) -> None:
    with Mesh(directory) as mesh:
        os.truncate(directory / "joined", 0)  # a mapped file would be SIGBUS from here on
        mesh.send(HEAD.pack(0.0, 0))
        with Mesh(directory) as newcomer:
            mesh.send(HEAD.pack(1.0, 0) + b"frame")
            assert newcomer.receive(1) == HEAD.pack(1.0, 0) + b"frame"
        (directory / "joined").unlink()
        with Mesh(directory) as newcomer:
            assert mesh.receive(0.01) is None
            mesh.send(HEAD.pack(2.0, 0) + b"frame")
            assert newcomer.receive(1) == HEAD.pack(2.0, 0) + b"frame"


def test_a_full_disk_is_reported_by_an_error(directory: Path) -> None:
    with files_up_to(0), pytest.raises(TransportError, match="joined: File too large"):
        Mesh(directory)
    assert not list(directory.glob("*.sock"))


@pytest.mark.parametrize("name", ["1-0.sock", "2-0.sock", "c.sock", "joined"])
def test_what_is_not_ours_in_the_directory_is_neither_obeyed_nor_harmed(directory: Path, tmp_path: Path, name: str) -> None:
    directory.mkdir(mode=0o700)
    victim = tmp_path / "victim"
    victim.write_text("precious")
    foreign = directory / name
    if name == "1-0.sock":
        foreign.write_text("mine")
    elif name == "2-0.sock":
        foreign.mkdir()
    elif name == "c.sock":
        stream = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        stream.bind(str(foreign))
        stream.listen()
    else:
        foreign.symlink_to(victim)
        with pytest.raises(TransportError, match="joined: Too many levels of symbolic links"):
            Mesh(directory)
        assert victim.read_text() == "precious"
        return
    with Mesh(directory) as mesh, Mesh(directory):
        assert mesh.receive(0) is None and mesh.participants == 2
    assert foreign.exists()
    if name == "c.sock":
        stream.close()


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


def test_more_losses_than_one_datagram_can_count_are_counted_by_the_next_ones(directory: Path) -> None:
    with Mesh(directory) as sender, Mesh(directory) as listener:
        sender.send(HEAD.pack(0.0, 0))
        sender._members.peers[0].missed = 0x1_2345
        for _ in range(3):
            sender.send(HEAD.pack(0.0, 0))
        while listener.receive(0.01) is not None:
            pass
        assert listener.lost == 0x1_2345


def test_a_directory_open_to_others_is_refused_with_the_remedy(directory: Path) -> None:
    directory.parent.chmod(0o755)
    with pytest.raises(TransportError, match="with mode 700; chmod 700 it, or choose another directory"):
        Mesh(directory)


def test_what_arrives_first_is_received_first_whatever_time_its_sender_says(directory: Path) -> None:
    with Mesh(directory) as listener, Mesh(directory) as honest, Mesh(directory) as early:
        for turn in range(20):
            honest.send(HEAD.pack(1e9 + turn, 0) + b"honest")
            early.send(HEAD.pack(0.0, 0) + b"early")
        received = [datagram[HEAD.size :] for _ in range(60) if (datagram := listener.receive(0.0)) is not None]
    assert received == [b"honest", b"early"] * 20


def test_a_participant_that_never_leaves_is_closed_with_the_interpreter(directory: Path) -> None:
    """At its end the interpreter closes sockets in an order of its own, those of the mesh before the mesh as well."""
    first, second = Mesh(directory), Mesh(directory)
    first.send(HEAD.pack(0.0, 0) + b"x")
    second.send(HEAD.pack(0.0, 0) + b"x")
    for mesh in (first, second):
        for peer in mesh._members.peers:
            peer.socket.close()
        mesh.close()
    assert not [path for path in directory.glob("*.sock") if path.is_socket()]


def test_sending_says_whether_anybody_had_room(directory: Path) -> None:
    datagram = HEAD.pack(0.0, 0) + bytes(70)
    with Mesh(directory) as sender:
        assert sender.send(datagram)  # nobody is there
        with Mesh(directory):
            said = [sender.send(datagram) for _ in range(3 * QUEUE_LIMIT)]
            assert said[:QUEUE_LIMIT] == [True] * QUEUE_LIMIT and said.count(False) == sender.dropped > 0
        assert sender.send(datagram)  # it has left


def test_a_participant_that_never_reads_takes_no_datagram_from_the_others(directory: Path) -> None:
    """A flooder joins, and never reads: what the controller gets was sent."""
    datagram = HEAD.pack(0.0, 0) + bytes(70)
    with Mesh(directory) as sender, Mesh(directory), Mesh(directory) as reader:
        said = []
        for _ in range(3 * QUEUE_LIMIT):
            said.append(sender.send(datagram))
            assert reader.receive(1.0) is not None
        assert all(said) and sender.dropped > 0


def test_a_participant_knows_while_there_is_only_one_other(directory: Path) -> None:
    with Mesh(directory) as first, Mesh(directory) as second:
        assert first._members.lone is None and second._members.lone is not None
        first.send(HEAD.pack(0.0, 0))
        assert first._members.lone is not None
        with Mesh(directory) as third:
            for each in (first, second):
                each.send(HEAD.pack(0.0, 0))
            assert all(each._members.lone is None for each in (first, second, third))
        for each in (first, second):
            while each.receive(0.0) is not None:
                pass
            assert each._members.lone is not None


def test_leaving_while_another_holds_the_lock_removes_the_socket(directory: Path) -> None:
    mesh = Mesh(directory)
    held = os.open(directory, os.O_RDONLY)
    fcntl.flock(held, fcntl.LOCK_EX)
    mesh.close()
    os.close(held)
    assert not list(directory.glob("*.sock"))


def test_a_flood_of_newcomers_is_let_in_up_to_a_number(directory: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One that let in whoever came was held for two seconds by 20,000 connections, and sent each datagram as often."""
    monkeypatch.setattr("transport.links.mesh_members.MOST", 3)
    with ExitStack() as stack:
        mesh, other = stack.enter_context(Mesh(directory)), stack.enter_context(Mesh(directory))
        (own,) = directory.glob(f"{os.getpid()}-0.sock")
        newcomers = [stack.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)) for _ in range(5)]
        for each in newcomers:
            each.connect(str(own))
        for _ in range(3):
            mesh._members.admit()
        assert mesh.receive(0.0) is None and mesh.participants == 4 and mesh.refused == 1
        newcomers[0].close()
        mesh.send(HEAD.pack(0.0, 0) + b"x")  # which finds that it has left
        mesh._members.admit()
        assert other.receive(1.0) is not None and mesh.participants == 4
        other.close()
        for each in newcomers[1:3]:
            each.close()
        mesh.close()
        assert own.parent.exists(), "two are there whom it does not know"
    crowd = [Mesh(directory) for _ in range(4)]
    with pytest.raises(TransportError, match="more than 3 participants; choose another channel"):
        Mesh(directory)
    for each_mesh in crowd:
        each_mesh.close()


def test_a_participant_with_a_full_backlog_is_passed_over(directory: Path) -> None:
    directory.mkdir(mode=0o700)
    path = directory / f"{os.getpid()}-900.sock"
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as stopped, ExitStack() as stack:
        stopped.bind(str(path))
        stopped.listen(0)
        with pytest.raises(BlockingIOError):
            while True:
                knock = stack.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET))
                knock.setblocking(False)
                knock.connect(str(path))
        with Mesh(directory) as mesh:
            assert mesh.participants == 1
        assert path.exists()
