"""The runner itself: statuses, streams, time limits, virtual time, and that nothing stays behind."""

from __future__ import annotations

import os
import shlex
import shutil
import signal
import subprocess
import sys
import threading
import time
import uuid
from pathlib import Path

import pytest

from tests.vcan.test_kernel import processes_that_name
from tests.waiting import LIMIT_S

pytestmark = pytest.mark.usefixtures("boots_kernels")

RUNNER = [sys.executable, "-m", "hil", "vcan"]

# Two processes on the bus: one answers every frame, one sends and prints the clock, the kernel's time stamp and the data.
PING_PONG = """
import os, socket, struct, time
def joined():
    bus = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    bus.setsockopt(socket.SOL_SOCKET, 35, 1)  # SO_TIMESTAMPNS
    bus.bind(("vcan0",))
    return bus
if os.fork() == 0:
    with joined() as bus:
        for _ in range(50):
            bus.send(struct.pack("=IB3x8s", 2, 1, bus.recv(16)[8:]))
    os._exit(0)
with joined() as bus:
    time.sleep(0.5)
    for i in range(50):
        bus.send(struct.pack("=IB3x8s", 1, 1, bytes([i])))
        frame, ((_, _, stamp),), *_ = bus.recvmsg(16, 64)
        print(time.time_ns(), time.monotonic_ns(), stamp.hex(), frame.hex())
        time.sleep(0.01)
os.wait()
"""


def vcan(*args: str, timeout: float = 100, **kwargs: object) -> subprocess.CompletedProcess[str]:
    kwargs = {"stdin": subprocess.DEVNULL, "text": True} | kwargs
    return subprocess.run([*RUNNER, *args], capture_output=True, timeout=timeout, **kwargs)  # type: ignore[call-overload, no-any-return]


def left_behind(token: str) -> list[str]:
    """Processes whose command line holds the token, and mounts of the runner."""
    return processes_that_name(token) + [line for line in Path("/proc/mounts").read_text().splitlines() if "hil-vcan" in line]


@pytest.mark.parametrize(
    ("command", "status"),
    [
        ("exit 0", 0),
        ("exit 7", 7),
        ("kill -9 $$", 137),
        ("kill -TERM $$", 143),
        ("exec no-such-program", 127),
        ("exec /etc/passwd", 126),
    ],
)
def test_exit_status_is_the_commands(command: str, status: int) -> None:
    assert vcan("--", "sh", "-c", command).returncode == status


def test_streams_stay_apart_and_whole() -> None:
    data = bytes(range(256)) * 8000
    script = "import sys; d = sys.stdin.buffer.read(); sys.stdout.buffer.write(d); sys.stderr.buffer.write(d[::-1])"
    done = vcan("--", sys.executable, "-c", script, input=data, text=False, stdin=None)
    assert done.stdout == data  # type: ignore[comparison-overlap]
    assert done.stderr == data[::-1]  # type: ignore[comparison-overlap]


def test_stdin_that_waited_for_its_reader_comes_to_its_end() -> None:
    """The command reads late, so that all on the way is full; then bytes come late, when all on the way is empty."""
    script = "import sys, time; time.sleep(2); r = sys.stdin.buffer.read; print(len(r(300_000)), flush=True); print(len(r()))"
    argv = [*RUNNER, "--", sys.executable, "-c", script]
    with subprocess.Popen(argv, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as child:
        assert child.stdin is not None and child.stdout is not None
        stop = threading.Timer(100, child.kill)
        stop.start()
        child.stdin.write(bytes(300_000))
        child.stdin.flush()
        first = child.stdout.readline()  # all that came before has been read
        time.sleep(0.5)
        child.stdin.write(bytes(100_000))
        child.stdin.close()
        rest = child.stdout.read()
        stop.cancel()
    assert (first, rest, child.returncode) == (b"300000\n", b"100000\n", 0)


def test_command_sees_no_terminal_and_an_empty_stdin() -> None:
    done = vcan(
        "--",
        sys.executable,
        "-c",
        "import sys; print(*(s.isatty() for s in (sys.stdin, sys.stdout, sys.stderr)), sys.stdin.read())",
    )
    assert done.stdout.split() == ["False"] * 3


def test_venv_and_environment_are_in_place() -> None:
    done = vcan(
        "--",
        sys.executable,
        "-c",
        "import sys, os, msgspec; print(sys.prefix, os.getcwd(), os.environ['COLOUR'])",
        env={**os.environ, "COLOUR": "blue"},
    )
    assert done.stdout.split() == [sys.prefix, os.getcwd(), "blue"], done.stderr


def test_vcan0_takes_fd_frames_and_is_up() -> None:
    done = vcan("--", "ip", "-d", "link", "show", "vcan0")
    assert "mtu 72" in done.stdout
    assert "UP" in done.stdout


def test_only_writable_directories_keep_what_is_written(tmp_path: Path) -> None:
    kept, lost = tmp_path / "kept", tmp_path / "lost"
    kept.mkdir()
    token = Path("/var/tmp") / f"hil-vcan-{uuid.uuid4().hex}"
    done = vcan(
        "--rw",
        str(kept),
        "--",
        "sh",
        "-c",
        f"mkdir -p {lost} && echo a >{kept}/a && echo b >{lost}/b && echo c >{token}",
    )
    assert done.returncode == 0, done.stderr
    assert (kept / "a").read_text() == "a\n"
    assert not lost.exists()
    assert not token.exists()


def test_time_limit_ends_the_command() -> None:
    token = uuid.uuid4().hex
    for limit in ("2", "20", "200"):  # a busy machine boots in more than the first
        done = vcan("--timeout", limit, "--", "sh", "-c", f"echo begun; sleep 1000; : {token}")
        assert done.returncode == 124
        if done.stdout:
            break
    assert "begun" in done.stdout
    assert "timed out" in done.stderr
    assert not left_behind(token)


@pytest.mark.parametrize("virtual", [[], ["--virtual-time"]], ids=["real", "virtual"])
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGKILL])
def test_signal_ends_all_and_nothing_stays(number: int, virtual: list[str]) -> None:
    token = uuid.uuid4().hex
    busy = f"echo begun; while :; do sleep 0.1; done & while :; do sleep 0.1; done; : {token}"
    runner = subprocess.Popen([*RUNNER, *virtual, "--", "sh", "-c", busy], stdin=subprocess.DEVNULL, stdout=subprocess.PIPE)
    assert runner.stdout is not None
    assert runner.stdout.readline() == b"begun\n"
    runner.send_signal(number)
    status = runner.wait(LIMIT_S)
    if number == signal.SIGKILL:  # then it is the kernel that ends the rest, in its own time
        limit = time.monotonic() + LIMIT_S
        while left_behind(token) and time.monotonic() < limit:
            time.sleep(0.01)
    else:
        assert status == 128 + number
    assert not left_behind(token)
    runner.stdout.close()


def test_closed_reader_ends_the_command() -> None:
    token = uuid.uuid4().hex
    runner = subprocess.Popen([*RUNNER, "--", "sh", "-c", f"yes; : {token}"], stdin=subprocess.DEVNULL, stdout=subprocess.PIPE)
    assert runner.stdout is not None
    runner.stdout.readline()
    runner.stdout.close()
    assert runner.wait(LIMIT_S) == 128 + signal.SIGPIPE
    assert not left_behind(token)


def test_what_the_command_leaves_running_ends_with_it() -> None:
    token = uuid.uuid4().hex
    done = vcan("--", "sh", "-c", f"setsid sh -c 'sleep 1000; : {token}' & echo done")
    assert (done.returncode, done.stdout) == (0, "done\n")
    assert not left_behind(token)


@pytest.mark.skipif(os.geteuid() != 0 or not shutil.which("setpriv"), reason="needs root and setpriv to give up namespaces")
@pytest.mark.parametrize("number", [None, signal.SIGTERM])
def test_without_namespaces_nothing_stays_either(number: int | None, tmp_path: Path) -> None:
    token = uuid.uuid4().hex
    plain = ["setpriv", "--bounding-set", "-sys_admin", "--inh-caps", "-sys_admin"]
    sleep = "sleep 1000" if number else "true"
    runner = subprocess.Popen(
        [*plain, *RUNNER, "--", "sh", "-c", f"echo begun; {sleep}; : {token}"],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        env={**os.environ, "TMPDIR": str(tmp_path)},
    )
    assert runner.stdout is not None
    assert runner.stdout.readline() == b"begun\n"
    if number:
        runner.send_signal(number)
    assert runner.wait(LIMIT_S) == (128 + number if number else 0)
    assert not left_behind(token)
    assert not list(tmp_path.iterdir())
    runner.stdout.close()


def test_native_backend_runs_inside_a_kernel_that_has_vcan() -> None:
    native = f"{shlex.join(RUNNER)} --backend native"
    seen = "ip -br link show vcan0; echo $VCAN_BACKEND; cat; exit 9"
    script = f"echo input | {native} -- sh -c '{seen}'; echo $?; {native} --timeout 1 -- sleep 9; echo $?"
    done = vcan("--backend", "uml", "--", "sh", "-c", script)
    assert "vcan0" in done.stdout, done.stderr
    assert done.stdout.split()[-4:] == ["native", "input", "9", "124"]


def test_an_hour_of_virtual_time_passes_at_once() -> None:
    begin = time.monotonic()
    done = vcan("--virtual-time", "--", "sh", "-c", "date +%s; sleep 3600; date +%s")
    before, after = map(int, done.stdout.split())
    assert 3600 <= after - before <= 3601
    assert time.monotonic() - begin < 1800


def test_two_virtual_runs_give_the_same_time_stamps() -> None:
    one, two = (vcan("--virtual-time", "--", sys.executable, "-c", PING_PONG) for _ in range(2))
    assert len(one.stdout.splitlines()) == 50, one.stderr
    assert one.stdout == two.stdout
