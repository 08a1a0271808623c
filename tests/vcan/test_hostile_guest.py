"""What a command in `hil vcan` can do to us: its words, its environment, what it leaves where its status stands."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from random import Random

import pytest

from hil.vcan import RunnerError, guest, uml
from hil.vcan.kernel import Kernel
from hil.vcan.supervise import RUNNER_FAILED, Wanted
from tests.waiting import LIMIT_S


def order(*command: str, writable: tuple[str, ...] = ()) -> list[str]:
    return uml.argv(Wanted(command=command, writable=writable), lambda wanted: Kernel(path=Path("/bin/true"), backend="uml"))


def in_a_shell(script: str, environ: dict[str, str]) -> subprocess.CompletedProcess[bytes]:
    """Run the script that becomes the command, as the guest does, in this machine's shell."""
    return subprocess.run(["sh", "-c", os.fsencode(script)], env=environ, capture_output=True)


@pytest.mark.parametrize("name", ["é", "OPTIND", "PPID", "UID", "a-b", "BASH_FUNC_x%%", "1x"])
def test_no_name_of_a_variable_ends_the_shell(name: str) -> None:
    script = guest.command(["sh", "-c", "echo $FINE"], {name: "x y", "FINE": "yes", "PATH": os.environ["PATH"]}, "uml", False)
    done = in_a_shell(script, {"PATH": os.environ["PATH"]})
    assert (done.returncode, done.stdout) == (0, b"yes\n"), done.stderr


@pytest.mark.parametrize("word", ["$(touch ran)", "`touch ran`", "'; touch ran #", "a\nb", "\udcff\udcfe", "-", "*", "\\"])
def test_every_argument_and_value_comes_as_it_is(word: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    script = guest.command(["printenv", "V"], {"V": word, "PATH": os.environ["PATH"]}, "uml", False)
    assert in_a_shell(script, {"PATH": os.environ["PATH"]}).stdout == os.fsencode(word) + b"\n"
    script = guest.command(["printf", "%s", word], {"PATH": os.environ["PATH"]}, "uml", False)
    assert in_a_shell(script, {"PATH": os.environ["PATH"]}).stdout == os.fsencode(word)
    assert not list(tmp_path.iterdir())


def test_what_would_not_come_to_the_guest_whole_is_refused() -> None:
    with pytest.raises(RunnerError, match=r"take \d+ bytes, 131072 at most; put the command into a script"):
        order("echo", *["x" * 100] * 2000)
    with pytest.raises(RunnerError, match="a comma or backslash in a directory's name"):
        order("true", writable=("/tmp/a,/etc",))


@pytest.mark.parametrize("left", [b"", b"x\n", b"-1\n", b"256\n", b"1" * 9, "٣\n".encode(), b"0", b"1_0\n"])
def test_a_status_that_is_none_is_said(left: bytes, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "kernel.log").write_bytes(b"its last words")
    (tmp_path / "status").write_bytes(left)
    assert uml._status(tmp_path) == RUNNER_FAILED and capfd.readouterr().err.startswith("hil vcan: the guest ")


def test_a_pipe_for_a_status_is_not_waited_for_and_last_words_are_few(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    os.mkfifo(tmp_path / "status")
    (tmp_path / "kernel.log").write_bytes(b"a" * 1_000_000)
    assert uml._status(tmp_path) == RUNNER_FAILED and len(capfd.readouterr().err) < 4_100
    (tmp_path / "status").unlink()
    (tmp_path / "status").write_text("130\n")
    assert uml._status(tmp_path) == 130


@pytest.mark.timeout(30)
def test_pipes_for_status_and_last_words_are_not_waited_for(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    os.mkfifo(tmp_path / "status")
    os.mkfifo(tmp_path / "kernel.log")
    assert uml._status(tmp_path) == RUNNER_FAILED and capfd.readouterr().err.startswith("hil vcan: the guest died")


# In a kernel of its own

RUNNER = [sys.executable, "-m", "hil", "vcan", "--backend", "uml"]
WORK = guest.WORK
OFF = "echo o >/proc/sysrq-trigger; sleep 60"
IN_A_KERNEL: dict[str, tuple[str, int]] = {
    "a status of its own": (f"echo 7 >{WORK}/status; exit 3", 3),
    "a status ahead, and then nothing": (f"rm -f {WORK}/status; {OFF}", RUNNER_FAILED),
    "a folder for a status": (f"mkdir {WORK}/status; exit 3", RUNNER_FAILED),
    "a link for a status": (f"ln -s /etc/hostname {WORK}/status.new; exit 3", RUNNER_FAILED),
    "a pipe for a status": (f"mkfifo {WORK}/status; {OFF}", RUNNER_FAILED),
    "an empty work directory": (f"rm -rf {WORK}/*; exit 3", 3),
    "no work directory": (f"umount -l {WORK}; exit 3", RUNNER_FAILED),
    "a work directory without a mode": (f"chmod 000 {WORK}; exit 3", 3),
    "a pipe for last words": (f"rm {WORK}/kernel.log; mkfifo {WORK}/kernel.log; {OFF}", RUNNER_FAILED),
    "a device for last words": (f"rm {WORK}/kernel.log; mknod {WORK}/kernel.log c 1 5; {OFF}", RUNNER_FAILED),
    "a kernel that is off": (OFF, RUNNER_FAILED),
    "a kernel that panics": ("echo c >/proc/sysrq-trigger; sleep 60", RUNNER_FAILED),
    "no /proc": ("umount -l /proc; exit 3", 3),
    "a file where /proc was": ("umount -l /proc; touch /proc/sysrq-trigger; exit 3", 3),
    "all killed": ("kill -9 -1; exit 3", 3),
    "its first process killed": ("kill -KILL 1; kill -TERM 1; exit 3", 3),
    "streams closed": ("exec 0<&- 1>&- 2>&-; exit 3", 3),
    "the terminals taken": ("echo x >/dev/tty1; stty -F /dev/tty2 raw; exit 3", 3),
    "the pipes taken away": ("rm -f /run/in /run/out /run/err; exit 3", 3),
    "all binaries gone": ("mount -t tmpfs none /usr/sbin; exit 3", 3),
    "a status beyond all": ("exit 300", 300 % 256),
    "who is left behind": ("for i in 1 2 3; do sleep 1000 & done; setsid sleep 1000 & exit 3", 3),
    "a signal to itself": ("kill -SEGV $$", 128 + 11),
}


@pytest.mark.usefixtures("boots_kernels")
@pytest.mark.parametrize("what", IN_A_KERNEL)
def test_what_a_guest_does_to_its_kernel_ends_it_with_a_status_of_ours(what: str, tmp_path: Path) -> None:
    command, status = IN_A_KERNEL[what]
    done = subprocess.run(
        [*RUNNER, "--", "sh", "-c", command], cwd=tmp_path, stdin=subprocess.DEVNULL, capture_output=True, text=True,
        timeout=LIMIT_S,
    )  # fmt: skip
    assert done.returncode == status and "Traceback" not in done.stderr, done.stderr
    if status == RUNNER_FAILED:
        assert done.stderr.startswith("hil vcan: the guest ") and len(done.stderr) < 4_100
    assert not any(tmp_path.iterdir())


@pytest.mark.usefixtures("boots_kernels")
def test_last_words_are_the_kernels_and_no_file_that_the_guest_points_at(tmp_path: Path) -> None:
    (tmp_path / "secret").write_text("a secret of the host\n")
    log = f"{WORK}/kernel.log"
    done = subprocess.run(
        [*RUNNER, "--", "sh", "-c", f"rm {log}; ln -s {tmp_path}/secret {log}; {OFF}"], cwd=tmp_path, stdin=subprocess.DEVNULL,
        capture_output=True, text=True, timeout=LIMIT_S,
    )  # fmt: skip
    assert done.returncode == RUNNER_FAILED and "secret" not in done.stderr, done.stderr


@pytest.mark.usefixtures("boots_kernels")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT])
def test_a_signal_at_any_instant_ends_it_with_its_status_and_without_a_traceback(number: int, tmp_path: Path) -> None:
    """From the import of the command line on; before it Python itself answers."""
    draw = Random(int(number))
    begun = "import os; os.write(1, b'begun\\n'); import runpy; runpy.run_module('hil', run_name='__main__')"
    for _ in range(5):
        command = [sys.executable, "-c", f"import signal, hil.errors as f; f.heed_signals(); {begun}"]
        words = ["vcan", "--backend", "uml", "--", "sh", "-c", "trap '' INT TERM HUP QUIT; while :; do sleep 0.1; done"]
        with subprocess.Popen([*command, *words], cwd=tmp_path, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                              stderr=subprocess.PIPE, text=True) as process:  # fmt: skip
            assert process.stdout is not None and process.stdout.readline() == "begun\n"
            time.sleep(draw.uniform(0.0, 2.5))
            process.send_signal(number)
            _, said = process.communicate(timeout=LIMIT_S)
        assert process.returncode == 128 + number and "Traceback" not in said, said
