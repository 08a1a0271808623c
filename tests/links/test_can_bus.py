"""The `hil` bus between real processes: what python-can promises, and what happens to the others when one dies."""

from __future__ import annotations

import asyncio
import os
import pty
import re
import select
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from time import monotonic, time, time_ns
from typing import Any

import can
import pytest

from tests.waiting import LIMIT_S, until
from transport import SensorPacket, dbc_path, encode_sensor, open_link
from transport.links.can_bus import HilBus
from transport.links.contract import SEND_LIMIT_S
from transport.links.mesh_members import HEAD, Peer
from transport.links.unix_mesh import QUEUE_LIMIT

BIN = Path(sys.executable).parent


@contextmanager
def process(*command: str | Path, ready: str = "ready") -> Iterator[subprocess.Popen[str]]:
    """A process that says when it is ready; killed in the end."""
    with subprocess.Popen([*map(str, command)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as running:
        try:
            if ready:
                assert running.stdout is not None and ready in running.stdout.readline()
            yield running
        finally:
            running.kill()


def python(program: str) -> tuple[str, str, str]:
    return sys.executable, "-c", "import can, sys\nbus = can.Bus('t', interface='hil')\nprint('ready', flush=True)\n" + program


IDLE = "sys.stdin.read()"


def bus(**kwargs: Any) -> HilBus:
    joined = can.Bus("t", interface="hil", **kwargs)
    assert isinstance(joined, HilBus)
    return joined


def frame(number: int, identifier: int = 0x100, size: int = 8) -> can.Message:
    data = number.to_bytes(4, "little") + bytes(size - 4)
    return can.Message(arbitration_id=identifier, is_extended_id=False, is_fd=size > 8, data=data)


def number_of(message: can.Message | None) -> int | None:
    return None if message is None else int.from_bytes(message.data[:4], "little")


def drain(listener: can.BusABC, timeout: float = 0.0) -> list[can.Message]:
    found = []
    while (message := listener.recv(timeout)) is not None:
        found.append(message)
    return found


@pytest.mark.parametrize(
    "message",
    [
        can.Message(arbitration_id=0x7FF, is_extended_id=False, data=b""),
        can.Message(arbitration_id=0x1FFFFFFF, is_extended_id=True, data=bytes(range(8))),
        can.Message(arbitration_id=0x123, is_extended_id=False, is_remote_frame=True, dlc=5),
        can.Message(arbitration_id=0x4, is_extended_id=False, is_error_frame=True, data=bytes(8)),
        can.Message(arbitration_id=1, is_extended_id=False, is_fd=True, data=bytes(range(64))),
        can.Message(arbitration_id=1, is_fd=True, bitrate_switch=True, data=bytes(20)),
        can.Message(arbitration_id=1, is_fd=True, error_state_indicator=True, data=bytes(12)),
    ],
    ids=["empty", "extended", "remote", "error", "fd", "fd-brs", "fd-esi"],
)
def test_every_kind_of_frame_arrives_as_it_was_sent(message: can.Message) -> None:
    with bus() as sender, bus() as listener:
        sender.send(message)
        received = listener.recv(1)
    assert received is not None and received.equals(message, timestamp_delta=None, check_channel=False, check_direction=False)


def test_all_listeners_get_the_same_time_stamp_which_is_the_senders() -> None:
    with bus() as sender, bus() as first, bus() as second:
        before = time()
        sender.send(frame(1))
        after = time()
        one, other = first.recv(1), second.recv(1)
    assert one is not None and other is not None and before <= one.timestamp == other.timestamp <= after


@pytest.mark.parametrize("option", [35, 9999], ids=["stamps", "a kernel without"])
def test_a_frame_of_a_link_is_logged_with_the_time_of_its_arrival(
    option: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("transport.links.mesh_members._SO_TIMESTAMPNS", option)
    with open_link("can:hil:t", "rig") as link, bus() as listener:
        times = []
        for _ in range(3):
            before = time()
            link.send(encode_sensor(SensorPacket(0, 0, 0, (1.0,))))
            received = listener.recv(1)
            assert received is not None and before - 1e-6 <= received.timestamp <= time() + 1e-6
            times.append(received.timestamp)
    assert times == sorted(times)


def test_waiting_frames_of_all_senders_are_read_in_the_order_of_sending() -> None:
    with bus() as a, bus() as b, bus() as listener:
        for number in range(40):
            (a if number % 3 else b).send(frame(number))
        assert [number_of(message) for message in drain(listener)] == list(range(40))


def test_own_messages_come_back_by_choice_only_and_are_marked() -> None:
    with bus() as plain, bus(receive_own_messages=True) as hearing:
        hearing.send(frame(1))
        plain.send(frame(2))
        mine, other = drain(hearing)
        assert (number_of(mine), mine.is_rx, number_of(other), other.is_rx) == (1, False, 2, True)
        assert [number_of(message) for message in drain(plain)] == [1]


def test_filters_keep_out_what_does_not_match_and_let_error_frames_pass() -> None:
    rules = [{"can_id": 0x100, "can_mask": 0x7C0, "extended": False}, {"can_id": 0x5, "can_mask": 0x1FFFFFFF}]
    with bus() as sender, bus(can_filters=rules) as listener:
        for identifier, extended in ((0x100, False), (0x13F, False), (0x140, False), (0x100, True), (5, True), (5, False)):
            sender.send(can.Message(arbitration_id=identifier, is_extended_id=extended))
        sender.send(can.Message(arbitration_id=0x700, is_extended_id=False, is_error_frame=True))
        heard = [(message.arbitration_id, message.is_extended_id) for message in drain(listener)]
        assert heard == [(0x100, False), (0x13F, False), (5, True), (5, False), (0x700, False)]
        listener.set_filters(None)
        sender.send(frame(1, 0x222))
        assert number_of(listener.recv(1)) == 1


def test_a_look_finds_the_frame_behind_others_that_a_filter_keeps_out() -> None:
    with bus() as sender, bus(can_filters=[{"can_id": 0x200, "can_mask": 0x7FF}]) as listener:
        for number in range(50):
            sender.send(frame(number, 0x100))
        sender.send(frame(99, 0x200))
        assert number_of(listener.recv(0)) == 99


def test_a_classic_participant_neither_sees_nor_sends_fd_frames() -> None:
    with bus() as sender, bus(fd=False) as classic:
        sender.send(frame(1, size=20))
        sender.send(frame(2))
        assert [number_of(message) for message in drain(classic)] == [2]
        with pytest.raises(can.CanOperationError, match="fd=False"):
            classic.send(frame(3, size=20))


@pytest.mark.parametrize(("size", "is_fd"), [(9, False), (65, True)])
def test_a_frame_too_long_for_its_kind_is_refused(size: int, is_fd: bool) -> None:
    with bus() as sender, pytest.raises(can.CanOperationError, match=f"{size} bytes do not fit"):
        sender.send(can.Message(is_fd=is_fd, data=bytes(size)))


def test_a_bus_that_was_shut_down_refuses_and_says_so() -> None:
    sender = bus()
    sender.shutdown()
    sender.shutdown()
    assert sender.fileno() == -1
    with pytest.raises(can.CanOperationError, match="shut down"):
        sender.send(frame(1))
    with pytest.raises(can.CanOperationError, match="shut down"):
        sender.recv(0)


def test_nothing_is_lost_within_the_queue_limit_and_what_is_beyond_is_counted_at_both_ends() -> None:
    with bus() as sender, bus() as listener:
        for number in range(QUEUE_LIMIT):
            sender.send(frame(number, size=64))
        assert sender.dropped == 0
        for number in range(QUEUE_LIMIT, 3 * QUEUE_LIMIT):
            sender.send(frame(number, size=64))
        kept = [number_of(message) for message in drain(listener)]
        assert kept == list(range(len(kept))) and len(kept) >= QUEUE_LIMIT
        assert sender.dropped == 3 * QUEUE_LIMIT - len(kept) > 0
        assert listener.lost == 0  # not known before the next frame
        sender.send(frame(0))
        assert listener.recv(1) is not None and listener.lost == sender.dropped


def test_a_sender_may_wait_for_room() -> None:
    with bus() as sender, bus() as listener:
        reader = threading.Thread(target=lambda: [listener.recv(LIMIT_S) for _ in range(3000)])
        reader.start()
        for number in range(3000):
            sender.send(frame(number), timeout=LIMIT_S)
        reader.join()
        assert sender.dropped == 0


def test_a_descriptor_shows_select_and_asyncio_that_frames_wait() -> None:
    with bus() as sender, bus(receive_own_messages=True) as listener:
        drain(listener)
        assert select.select([listener.fileno()], [], [], 0)[0] == []
        sender.send(frame(1))
        listener.send(frame(2))
        assert select.select([listener.fileno()], [], [], 1)[0]
        assert [number_of(message) for message in drain(listener)] == [1, 2]
        assert select.select([listener.fileno()], [], [], 0)[0] == []

        async def read() -> list[int | None]:
            reader = can.AsyncBufferedReader()
            notifier = can.Notifier(listener, [reader], loop=asyncio.get_running_loop())
            for number in range(20):
                sender.send(frame(number))
            numbers = [number_of(await asyncio.wait_for(reader.get_message(), LIMIT_S)) for _ in range(20)]
            notifier.stop()
            return numbers

        assert asyncio.run(read()) == list(range(20))


def test_a_notifier_thread_reads_while_others_join_and_send() -> None:
    reader = can.BufferedReader()
    with ExitStack() as stack:
        listener = stack.enter_context(bus())
        notifier = can.Notifier(listener, [reader], timeout=0.05)
        for number in range(12):
            stack.enter_context(bus()).send(frame(number))
        assert [number_of(reader.get_message(LIMIT_S)) for _ in range(12)] == list(range(12))
        notifier.stop()


def test_what_came_before_a_connection_was_let_in_is_older_than_what_came_after() -> None:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with ours, theirs:
        theirs.send(HEAD.pack(0.0, 0))
        peer, admitted = Peer(ours), time_ns()
        theirs.send(HEAD.pack(0.0, 0))
        before = peer.arrival_ns()
        ours.recv(64)
        assert 0 < before <= admitted <= peer.arrival_ns()


def test_a_participant_receives_everything_that_is_sent_once_it_has_joined() -> None:
    with bus() as sender:
        for number in range(20):
            sender.send(frame(number))
            with bus() as newcomer:
                sender.send(frame(100 + number))
                assert [number_of(message) for message in drain(newcomer)] == [100 + number]


def test_processes_that_join_at_once_all_receive_from_each_other() -> None:
    program = """
import can, os, sys, threading
import transport.links.can_bus
ready, go, done = os.pipe(), os.pipe(), os.pipe()
for number in range(8):
    if not os.fork():
        bus = can.Bus("t", interface="hil")
        os.write(ready[1], b"r")
        os.read(go[0], 1)
        bus.send(can.Message(arbitration_id=number))
        heard = set()
        while len(heard) < 7:
            heard.add(bus.recv(120).arbitration_id)
        os.write(done[1], b"d")
        os.read(go[0], 1)  # no process leaves before all have received all
        os._exit(0)
for count, (pipe, word) in enumerate(((ready, b"g"), (done, b"g"))):
    for _ in range(8):
        assert os.read(pipe[0], 1)
    os.write(go[1], 8 * word)
while True:
    try:
        assert os.wait()[1] == 0
    except ChildProcessError:
        break
print("heard", flush=True)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=LIMIT_S)
    assert done.stdout == "heard\n", done.stderr


def test_a_killed_process_blocks_no_other_and_the_next_to_join_clears_it_away(bus_directory: Path) -> None:
    with bus() as sender, bus() as listener:
        with process(*python(IDLE)) as victim:
            sender.send(frame(1))
            assert number_of(listener.recv(1)) == 1
            victim.kill()
            victim.wait()
        assert len(list((bus_directory / "t").glob("*.sock"))) == 3
        for number in range(2, 1000):
            sender.send(frame(number))
            assert number_of(listener.recv(1)) == number
        assert sender.dropped == 0 and sender.participants == 2
        with bus():
            assert len(list((bus_directory / "t").glob("*.sock"))) == 3


def test_what_a_process_sent_before_it_was_killed_still_arrives() -> None:
    program = "[bus.send(can.Message(arbitration_id=n)) for n in range(50)]; print('sent', flush=True); " + IDLE
    with bus() as listener, process(*python(program)) as sender:
        assert sender.stdout is not None and sender.stdout.readline() == "sent\n"
        listener.send(frame(0))  # which it never reads
        sender.kill()
        sender.wait()
        listener.send(frame(0))
        assert [message.arbitration_id for message in drain(listener, 0.1)] == list(range(50))
        assert listener.participants == 1


def test_a_stopped_process_blocks_no_other_and_learns_what_it_missed() -> None:
    program = """
import select
while bus.recv(120).arbitration_id != 0x7FF:
    pass
print(bus.lost, flush=True)
"""
    number = 4 * QUEUE_LIMIT
    with bus() as sender, bus() as listener, process(*python(program)) as sleeper:
        os.kill(sleeper.pid, signal.SIGSTOP)
        slowest, heard = 0.0, 0
        for count in range(number):
            begin = monotonic()
            sender.send(frame(count))
            slowest = max(slowest, monotonic() - begin)
            heard += listener.recv(1) is not None
        assert slowest < SEND_LIMIT_S and heard == number
        dropped = sender.dropped
        assert 0 < dropped <= number - QUEUE_LIMIT
        os.kill(sleeper.pid, signal.SIGCONT)
        sender.send(frame(0, 0x7FF), timeout=LIMIT_S)
        assert sleeper.stdout is not None and int(sleeper.stdout.readline()) == dropped


def test_nothing_is_left_behind_by_the_last_to_leave(bus_directory: Path) -> None:
    with bus(), bus():
        assert [config["channel"] for config in can.detect_available_configs("hil")] == ["t"]
    assert list(bus_directory.iterdir()) == []


def test_the_last_one_alive_clears_away_what_killed_processes_left(bus_directory: Path) -> None:
    with bus() as survivor, process(*python(IDLE)) as first, process(*python(IDLE)) as second:
        survivor.send(frame(1))
        first.kill()
        first.wait()
        with bus():
            pass
        assert len(list((bus_directory / "t").glob("*.sock"))) == 2  # who leaves among the living leaves them alone
        second.kill()
        second.wait()
    assert list(bus_directory.iterdir()) == []


def test_a_directory_open_to_others_is_refused(bus_directory: Path) -> None:
    bus_directory.chmod(0o755)
    with pytest.raises(can.CanInitializationError, match="mode 700"):
        bus()


@pytest.mark.parametrize("name", ["", "../x", "a/b", ".hidden", "x" * 33, "a b"])
def test_a_channel_name_that_is_no_plain_name_is_refused(name: str) -> None:
    with pytest.raises(can.CanInitializationError, match=re.escape(repr(name))):
        can.Bus(name, interface="hil")


def test_a_path_too_long_for_a_socket_is_named(monkeypatch: pytest.MonkeyPatch, bus_directory: Path) -> None:
    monkeypatch.setenv("HIL_CAN_DIR", str(bus_directory / ("x" * 100)))
    with pytest.raises(can.CanInitializationError, match="at most 107 bytes"):
        bus()


def test_periodic_frames_go_out() -> None:
    with bus() as sender, bus() as listener:
        task = sender.send_periodic(frame(5), 0.002)
        assert [number_of(listener.recv(LIMIT_S)) for _ in range(10)] == [5] * 10
        task.stop()


def test_can_logger_writes_what_can_player_plays_back(tmp_path: Path) -> None:
    log, number = tmp_path / "run.log", 400  # some of its buffers, which it writes out when they are full
    with bus() as sender:
        with process(BIN / "can_logger", "-i", "hil", "-c", "t", "-f", log, ready="Connected to HilBus") as logger:
            for count in range(number):
                sender.send(frame(count, size=20), timeout=LIMIT_S)
            until(lambda: log.exists() and log.read_text().count("##") >= number // 2, "half of the frames in the log")
            logger.send_signal(signal.SIGINT)
            logger.wait(LIMIT_S)
        lines = log.read_text().splitlines()
        assert len(lines) >= number // 2 and all("##" in line for line in lines)
        log.write_text("\n".join(lines[:50]) + "\n")
        command = [str(BIN / "can_player"), "-i", "hil", "-c", "t", "--fd", "-g", "0.0001", str(log)]
        subprocess.run(command, check=True, timeout=LIMIT_S)
        played = drain(sender)
        assert [number_of(message) for message in played] == list(range(50))
        assert all(message.is_fd and message.dlc == 20 for message in played)


def test_cantools_monitor_shows_our_signals() -> None:
    main, side = pty.openpty()
    command = [str(BIN / "cantools"), "monitor", "-i", "hil", "-c", "t", str(dbc_path())]
    environment = {**os.environ, "TERM": "xterm", "LINES": "40", "COLUMNS": "120"}
    with (
        open_link("can:hil:t?pad=1", "rig") as rig,
        subprocess.Popen(command, stdin=side, stdout=side, stderr=side, env=environment) as monitor,
    ):
        try:
            screen = b""

            def shown() -> bool:
                nonlocal screen
                rig.send(encode_sensor(SensorPacket(7, 0, 5, (3.25,))))
                if select.select([main], [], [], 0.05)[0]:
                    screen += os.read(main, 65536)
                return b"SensorFD0" in screen and b"Y0: 3.25" in screen

            until(shown, "the signal on the screen")
        finally:
            monitor.kill()
    os.close(main)
    os.close(side)


def test_frames_that_a_filter_keeps_out_hold_no_call_and_are_counted() -> None:
    """The clock here goes on by 1 ms with each frame: a call of 5 ms passes over five of them, a look over twenty."""
    from itertools import count

    from transport.links import hil_frames

    ticks = count()
    with HilBus("skip", can_filters=[{"can_id": 0x140, "can_mask": 0x7FF, "extended": False}]) as bus, HilBus("skip") as other:
        for _ in range(40):
            other.frames.send_frame(0x300, b"")
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(hil_frames, "monotonic", lambda: next(ticks) / 1e3)
            assert bus.frames.recv_frame(0.005) is None and bus.frames.filtered == 5
            assert bus.frames.recv_frame(0) is None and bus.frames.filtered in (25, 26)
