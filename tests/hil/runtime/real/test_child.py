"""What is asked of a child fifty times a second costs nothing that adds up, what it loads, and which signals stop it."""

from __future__ import annotations

import json
import os
import pickle
import signal
import subprocess
import sys
from errno import ENOSYS
from pathlib import Path
from socket import socketpair

import pytest

from hil.compose import compose
from hil.experiment import load_experiment
from hil.runtime.real.child import PYTHON, Child, is_open, is_stopped, other_is_open, python_module
from hil.runtime.real.ending import StopSignals
from tests.waiting import until

OFTEN = """
import os
import hil.session
import pytest

from hil.runtime.real.child import Child, is_stopped

def anonymous_kb():
    with open("/proc/self/status") as file:
        return int(file.read().split("RssAnon:")[1].split()[0])

for _ in range(100):
    is_stopped(os.getpid())
before = anonymous_kb()
for _ in range(60_000):
    is_stopped(os.getpid())
print(anonymous_kb() - before)
"""


def test_asking_for_twenty_minutes_takes_no_memory() -> None:
    """A session grew by 0.94 MB at 432 s: the parts of a path are kept in a table, which was made anew at twice its size."""
    reported = subprocess.run([sys.executable, "-c", OFTEN], capture_output=True, text=True, check=True)
    assert int(reported.stdout) < 150


def test_a_process_that_is_stopped_is_distinguished_from_one_that_runs_and_from_none() -> None:
    with subprocess.Popen(["sleep", "60"]) as process:
        try:
            assert not is_stopped(process.pid)
            process.send_signal(signal.SIGSTOP)
            os.waitid(os.P_PID, process.pid, os.WSTOPPED)
            assert is_stopped(process.pid)
        finally:
            process.kill()
    assert not is_stopped(process.pid)


def test_an_interrupt_cuts_off_no_import_of_a_child() -> None:
    """SIGINT is blocked from before its first instruction on; here it is not blocked any more."""
    child = Child("rig", "json.tool", None)
    blocked = int(Path(f"/proc/{child.pid}/status").read_text().partition("SigBlk:")[2].split()[0], 16)
    child.kill()
    assert blocked >> (signal.SIGINT - 1) & 1 and signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())


def test_a_job_that_never_comes_whole_ends_a_child_without_a_traceback() -> None:
    """The session was interrupted while it sent the rig what to run."""
    run = python_module("hil.runtime.real.child", "hil.runtime.real.rig_process")
    done = subprocess.run(run, input=b"\x80\x04", capture_output=True)
    assert done.returncode == 1 and done.stderr == b""


PART = """
import atexit, sys, threading, time
def main(job):
    thread = threading.Thread(target=lambda: (time.sleep(0.2), print("thread", flush=True)))
    thread.start()
    atexit.register(print, "exit function")
    print("job", job)
    {end}
"""


@pytest.mark.parametrize(
    ("end", "status", "said"),
    [
        ("", 0, ""),
        ("sys.exit(5)", 5, ""),
        ("sys.exit('hil: no link')", 1, "hil: no link"),
        ("raise ValueError('not so')", 1, "ValueError: not so"),
    ],
)
def test_a_child_ends_as_python_does(end: str, status: int, said: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Its threads are waited for, its exit functions run, its status is what it says."""
    (tmp_path / "own_part_of_a_child.py").write_text(PART.format(end=end))
    child = Child("rig", "own_part_of_a_child", 7, folders=[str(tmp_path)])
    assert child.wait(60.0) and child.poll() == status
    received = capfd.readouterr().err
    assert [received.index(each) for each in ("job 7", "thread", "exit function")] and said in received


def test_a_child_ends_where_the_environment_keeps_python_for_more_words(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """PYTHONINSPECT: the rig read standard input behind its last line, and ended with status 1."""
    monkeypatch.setenv("PYTHONINSPECT", "1")
    (tmp_path / "own_part_of_a_child.py").write_text(PART.format(end=""))
    child = Child("rig", "own_part_of_a_child", 7, folders=[str(tmp_path)])
    assert child.wait(60.0) and child.poll() == 0


@pytest.mark.parametrize("old_kernel", [False, True])
def test_a_child_that_ends_is_noticed_by_its_parent_and_leaves_no_descriptor(
    old_kernel: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a kernel before 5.3 nothing wakes who waits, and Python looks again and again."""

    def refused(pid: int) -> int:
        raise OSError(ENOSYS, "Function not implemented")

    if old_kernel:
        monkeypatch.setattr(os, "pidfd_open", refused)
    (tmp_path / "own_part_of_a_child.py").write_text(PART.format(end="sys.exit(5)"))
    before = len(os.listdir("/proc/self/fd"))
    child = Child("rig", "own_part_of_a_child", 7, folders=[str(tmp_path)])
    assert not child.wait(0.0)
    assert child.wait(60.0) and child.wait(60.0) and child.poll() == 5
    assert len(os.listdir("/proc/self/fd")) == before
    (tmp_path / "own_part_of_a_child.py").write_text(PART.format(end="time.sleep(600)"))
    hanging = Child("rig", "own_part_of_a_child", 7, folders=[str(tmp_path)])
    hanging.kill()
    assert len(os.listdir("/proc/self/fd")) == before and hanging.how().endswith("was killed by SIGKILL")


@pytest.mark.parametrize(("own", "expected"), [(None, "1"), ("3", "3")])
def test_a_child_has_one_blas_thread_where_its_user_says_nothing_else(
    own: str | None, expected: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    if own is not None:
        monkeypatch.setenv("OPENBLAS_NUM_THREADS", own)
    child = Child("rig", "json.tool", None)
    environment = Path(f"/proc/{child.pid}/environ")
    until(lambda: b"OPENBLAS_NUM_THREADS=" in environment.read_bytes(), "the environment of a process that begins")
    said = environment.read_bytes().split(b"\0")
    child.kill()
    assert f"OPENBLAS_NUM_THREADS={expected}".encode() in said


TRY = """
import json, pickle, sys
from importlib import import_module
import_module(sys.argv[1])
from transport.links.opening import open_link
loop = pickle.load(sys.stdin.buffer)
loop.start_controller()
open_link("can:hil:loads" + sys.argv[2], "rig").close()
print(json.dumps(sorted(sys.modules)))
"""
OTHERS = ("can", "scipy", "difflib", "importlib.resources", "click", "rich", "hil.compose", "hil.certify", "hil.session")
OTHERS += ("importlib.metadata", "email", "design.networked_loop", "design.jump_linear", "design.requests")
OTHERS += ("transport.laws.latency", "transport.can_bus_model.bus", "transport.links.timed_sender")


@pytest.mark.parametrize("name", ["rig", "controller"])
def test_a_process_of_a_session_loads_neither_certifiers_nor_python_can(name: str) -> None:
    job, module = pickle.dumps(compose(load_experiment("dc-motor-hinf"))), f"hil.runtime.real.{name}_process"
    done = subprocess.run([*PYTHON, "-c", TRY, module, name], input=job, capture_output=True, check=True)
    loaded = {module for module in json.loads(done.stdout) if module.startswith(OTHERS)}
    unneeded = {module for module in loaded if module in OTHERS or module.startswith(tuple(f"{other}." for other in OTHERS))}
    assert not unneeded


THREE = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@pytest.mark.parametrize("ignored", [signal.SIGINT, signal.SIGHUP])
def test_what_is_ignored_stays_ignored_and_sigterm_still_stops(ignored: int) -> None:
    before = signal.signal(ignored, signal.SIG_IGN)
    try:
        with StopSignals() as signals:
            signal.raise_signal(ignored)
            assert signals.seen is None
            signal.raise_signal(signal.SIGTERM)
            assert signals.seen == signal.SIGTERM
        assert signal.getsignal(ignored) == signal.SIG_IGN
    finally:
        signal.signal(ignored, before)


@pytest.mark.parametrize("number", THREE)
def test_each_stops_and_every_handler_comes_back(number: int) -> None:
    before, reported = [signal.getsignal(each) for each in THREE], []
    with StopSignals(reported.append) as signals:
        signal.raise_signal(number)
    assert signals.seen == number and reported == [number]
    assert [signal.getsignal(each) for each in THREE] == before


def test_the_two_processes_of_a_session_wait_for_each_other_and_no_longer_than_they_live() -> None:
    ours, theirs = socketpair()
    with ours, theirs:
        assert not other_is_open(ours.fileno(), 0.01) and not other_is_open(ours.fileno(), 600.0, lambda: True)
        is_open(theirs.fileno())
        assert other_is_open(ours.fileno(), 600.0)
        theirs.close()
        assert not other_is_open(ours.fileno(), 600.0)
        is_open(ours.fileno())
    assert other_is_open(-1)
