"""The file of a bus that takes time: a process that is stopped or killed with it in hand stops no other."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from time import monotonic, monotonic_ns

import can
import pytest

from tests.waiting import LIMIT_S, ended, until
from transport.can_bus_model import BitRates, CanFrame
from transport.links import TransportError, shared_bus
from transport.links.can_bus import bus_directory
from transport.links.held_bus import Ended, HeldBus
from transport.links.shared_bus import HELD_S, BusFile, SharedBus

HOLDER = """
import sys
from pathlib import Path
from transport.links.shared_bus import BusFile

def change(text):
    print("held", text.decode(), flush=True)
    sys.stdin.readline()
    return text + b" child"

file = BusFile(Path(sys.argv[1]))
file.change(change)
print("done", flush=True)
"""


@contextmanager
def holder(directory: Path) -> Iterator[subprocess.Popen[str]]:
    """A process that holds the file until it gets a line."""
    command = [sys.executable, "-c", HOLDER, str(directory)]
    with ended(subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)) as process:
        assert process.stdout is not None and process.stdout.readline().startswith("held")
        try:
            yield process
        finally:
            process.kill()


def state(file: BusFile) -> str:
    seen: list[bytes] = []

    def look(text: bytes) -> bytes:
        seen.append(text)
        return text

    file.change(look)
    return seen[-1].decode()


def say(process: subprocess.Popen[str], line: str = "on") -> None:
    assert process.stdin is not None
    process.stdin.write(f"{line}\n")
    process.stdin.flush()


def test_others_go_on_without_a_process_that_is_stopped_and_it_does_its_change_again_behind_theirs(tmp_path: Path) -> None:
    ours = BusFile(tmp_path)
    ours.change(lambda text: b"begin")
    with holder(tmp_path) as process:
        os.kill(process.pid, signal.SIGSTOP)
        begin = monotonic()
        ours.change(lambda text: text + b" ours")
        assert HELD_S <= monotonic() - begin < LIMIT_S
        assert state(ours) == "begin ours" and [path.name for path in tmp_path.iterdir()] == ["bus.1"]
        ours.change(lambda text: text + b" again")
        os.kill(process.pid, signal.SIGCONT)
        say(process)
        assert process.stdout is not None and process.stdout.readline() == "held begin ours again\n"  # called again
        say(process)
        assert process.stdout.readline() == "done\n"
    assert state(ours) == "begin ours again child"


def test_two_that_are_stopped_one_behind_the_other_stop_no_other(tmp_path: Path) -> None:
    ours = BusFile(tmp_path)
    ours.change(lambda text: b"begin")
    with holder(tmp_path) as first, holder(tmp_path) as second:  # the second went on without the first, and wrote nothing
        for process in (first, second):
            os.kill(process.pid, signal.SIGSTOP)
        assert state(ours) == "begin"
        ours.change(lambda text: text + b" ours")
    assert state(ours) == state(BusFile(tmp_path)) == "begin ours"


def test_a_process_that_is_killed_lets_go_and_leaves_the_state_before_it(tmp_path: Path) -> None:
    ours = BusFile(tmp_path)
    ours.change(lambda text: b"a state that is much longer than the next one")
    ours.change(lambda text: b"state")
    with holder(tmp_path) as process:
        process.kill()
        process.wait()
        assert state(ours) == "state" and [path.name for path in tmp_path.iterdir()] == ["bus.0"]


def test_a_state_that_was_half_written_does_not_count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The process ends between the state and the head that says where it is."""
    ours = BusFile(tmp_path)
    ours.change(lambda text: b"before")
    write, calls = os.pwrite, []

    def once(file: int, text: bytes, place: int) -> int:
        calls.append(place)
        if len(calls) > 1:
            raise OSError("killed")
        return write(file, text, place)

    with monkeypatch.context() as patch:
        patch.setattr(os, "pwrite", once)
        with pytest.raises(OSError, match="killed"):
            ours.change(lambda text: b"half")
    assert state(ours) == "before"


@pytest.mark.parametrize("owner", [b'"x"', b"1.5", b"null", b"[]"])
def test_a_state_with_a_value_of_another_type_begins_a_new_bus(tmp_path: Path, owner: bytes) -> None:
    first = SharedBus(tmp_path, BitRates(500_000), lambda ended: None)
    file = BusFile(tmp_path)
    file.change(lambda text: re.sub(rb"\d{12,}(?=,\[\],\[\])", owner, text))
    assert owner in state(file).encode()
    second = SharedBus(tmp_path, BitRates(250_000), lambda ended: None)
    assert second.look().state == "active" and HeldBus(state(file).encode()).living.rates == BitRates(250_000)
    for each in (first, second, file):
        each.close()


def test_a_participant_with_another_clock_is_refused_and_leaves_nothing_open(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its frames would wait for an instant that comes in a day, or came a day ago."""
    first = SharedBus(tmp_path, BitRates(500_000), print)
    monkeypatch.setattr(shared_bus, "namespace", lambda kind: f"{kind}:[1]")
    files = os.listdir("/proc/self/fd")
    with pytest.raises(TransportError, match="the bus counts the time of another time namespace, as a container may have"):
        SharedBus(tmp_path, BitRates(500_000), print)
    assert os.listdir("/proc/self/fd") == files
    first.close()


def test_a_frame_is_queued_once_where_others_went_on_meanwhile(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ends: list[Ended] = []
    sender, listener = (SharedBus(tmp_path, BitRates(500_000), ends.append) for _ in range(2))
    newest, asked = BusFile._is_newest, []

    def not_at_first(file: BusFile) -> bool:
        asked.append(file)
        return newest(file) if len(asked) != 3 else False  # of the lock, before the writing, and now behind it

    monkeypatch.setattr(BusFile, "_is_newest", not_at_first)
    sender.queue([(CanFrame(identifier=0x100), 1)])
    assert len(asked) > 3
    begin = monotonic_ns()
    until(lambda: sender.look().waiting == 0, "the frame")
    assert [end.tag for end in ends if end.error_bit is None] == [1] and ends[-1].end_ns < begin + 10**9
    sender.close(), listener.close()


PROGRAM = """
import can, sys
from transport.links.shared_bus import BusFile
bus = can.Bus("t", interface="hil", timed=1, bitrate="500k")
bus.frames.timed._bus._file.change(lambda text: (print("held", flush=True), sys.stdin.read())[0] or text)
"""


@pytest.mark.parametrize("how", [signal.SIGSTOP, signal.SIGKILL])
def test_frames_go_on_while_a_participant_is_stopped_or_killed_that_holds_the_bus(how: signal.Signals) -> None:
    def join() -> can.BusABC:
        return can.Bus("t", interface="hil", timed=True, bitrate="500k")

    with join() as sender, join() as listener:
        command = [sys.executable, "-c", PROGRAM]
        with ended(subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)) as process:
            assert process.stdout is not None and process.stdout.readline() == "held\n"
            os.kill(process.pid, how)
            for n in range(20):
                sender.send(can.Message(arbitration_id=n, is_extended_id=False))
            found = [listener.recv(LIMIT_S) for _ in range(20)]
            assert [None if each is None else each.arbitration_id for each in found] == list(range(20))
            process.kill()
    assert not (bus_directory() / "t").exists() or not any((bus_directory() / "t").glob("bus.*"))
