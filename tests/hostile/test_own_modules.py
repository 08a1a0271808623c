"""Users' modules that end, silence, hold or copy their process: the status is never 0, and there is one message."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.waiting import ended, until
from tests.warm_hil import hil_command

HIL = str(Path(sys.executable).with_name("hil"))
PYTEST = [HIL.replace("/hil", "/pytest"), "-q", "-p", "no:hypothesispytest"]
"""Without a plug-in that imports all of hypothesis at the end."""

MODULE = '''
import ctypes, os, pathlib, signal, subprocess, sys, threading, time
from dataclasses import dataclass
from plants import DCMotor

class Running:
    def __init__(self, inner):
        self.inner, self.last, self.slots = inner, time.monotonic(), 0
    def advance(self, dt_ns, u, w=()):
        now = time.monotonic()  # a warm-up does not keep the period
        self.slots, self.last = self.slots + (now - self.last > 0.03), now
        if self.slots == 5:
            in_the_run()
        return self.inner.advance(dt_ns, u, w)
    def __getattr__(self, name):
        return getattr(self.__dict__["inner"], name)

@dataclass(frozen=True, kw_only=True)
class Mine(DCMotor):
    def start(self, rng):
        at_start()
        return Running(super().start(rng))

def in_a_worker(view):
    """The peak."""
    if "loky" in " ".join(sys.orig_argv):
        ctypes.CDLL(None)._exit(0)
    return 1.0

def at_start(): pass
def in_the_run(): pass
'''
LEAVE = "ctypes.CDLL(None)._exit(0)"
ENDS = {
    "os._exit": ("os._exit(0)", 2, "line 32: RuntimeError: os._exit would end, copy or replace"),
    "os.execv": ("os.execvp('true', ['true'])", 2, "os.execv would end, copy or replace"),
    "fork": ("os.fork()", 2, "os.fork would end, copy or replace"),
    "C's exit": (LEAVE, 1, "the process ended with status 0 before the command was done"),
    "C's exit at a start": (f"def at_start(): {LEAVE}", 1, "the process ended with status 0 before the command was done"),
    "exit of a thread": ("threading.Thread(target=os._exit, args=(0,)).start()\ntime.sleep(60)", 1, "ended with status 0 before"),
    "SystemExit": ("sys.exit(0)", 2, "line 32: SystemExit: 0"),
    "SIGKILL": ("os.kill(os.getpid(), 9)", 137, "the command was killed by SIGKILL before it was done"),
    "closes 0 to 2": ("os.closerange(0, 3)", 1, "it closes or replaces standard output"),
    "closes all": ("os.closerange(0, 4096)", 1, "it closes or replaces standard output"),
    "takes standard output": ("os.dup2(os.open('/dev/null', os.O_WRONLY), 1)", 2, "it closes or replaces standard output"),
    "signals": ("signal.signal(signal.SIGINT, signal.SIG_IGN)", 2, "it changes the handler of SIGINT"),
    "sys.stdout": ("sys.stdout = None", 2, "it replaces sys.stdout"),
    "sys.stdout at a start": ("def at_start(): sys.stdout = None", 1, "it replaces sys.stdout"),
    "folder": ("os.chdir('/')", 2, "it changes the working folder"),
    "environment": ("os.environ.clear()", 2, "from the environment; a module that is loaded leaves its process as it was"),
    "a thread": ("threading.Thread(target=threading.Event().wait).start()", 1, "an exit function did not end, and was killed"),
}  # fmt: skip
"""What the module does in its line 32, the exit status, and what is said."""


def command(folder: Path, does: str, *options: str, name: str = "run") -> list[str]:
    (folder / "mine.py").write_text(MODULE + does + "\n")
    return [HIL, name, "dc-motor-hinf", "--set", "plant={kind='mine:Mine'}", "--set", "duration=0.5 s", *options]


@pytest.mark.parametrize("what", ENDS)
def test_a_module_that_leaves_or_changes_its_process_is_one_message(what: str, tmp_path: Path) -> None:
    does, status, line = ENDS[what]
    asked = command(tmp_path, does, "-o", "a.mcap")
    if what.startswith("closes"):  # the end of Python itself meets no descriptors
        done = subprocess.run(asked, cwd=tmp_path, capture_output=True, text=True, timeout=120)
    else:
        done = hil_command(*asked[1:], cwd=tmp_path, timeout=120)
    assert done.returncode == status and line in done.stderr and done.stderr.count("hil: ") == 1, (done.returncode, done.stderr)
    assert "Traceback" not in done.stderr and not (status == 2 and (tmp_path / "a.mcap").exists())


def test_a_module_that_ends_a_command_which_says_how_far_it_is_is_one_message(tmp_path: Path) -> None:
    """What says so is a thread, and a process of two threads is not watched: the command ended with status 0."""
    (tmp_path / "mine.py").write_text(f"{MODULE}{LEAVE}\n")
    asked = ("problems", "--controller", "kind='mine:Mine'", "--only", "motor-5g", "--runs", "2")
    done = hil_command(*asked, cwd=tmp_path, timeout=120)
    assert done.returncode == 1 and ENDS["C's exit"][2] in done.stderr, done.stderr


HANGS = {
    "a loop": "pathlib.Path('there').touch()\nwhile True: pass",
    "a loop that heeds nothing": "pathlib.Path('there').touch()\nwhile True:\n try: time.sleep(1)\n except BaseException: pass",
    "signals blocked": "signal.pthread_sigmask(signal.SIG_BLOCK, range(1, 32))\npathlib.Path('there').touch()\ntime.sleep(600)",
    "a loop and at its end": "import atexit\natexit.register(time.sleep, 600)\npathlib.Path('there').touch()\nwhile True: pass",
    "at its end": "import atexit\natexit.register(time.sleep, 600)\natexit.register(pathlib.Path('there').touch)",
}  # fmt: skip


@pytest.mark.parametrize("what", HANGS)
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_module_that_hangs_ends_by_a_signal(what: str, number: int, tmp_path: Path) -> None:
    asked = command(tmp_path, HANGS[what], "-o", "a.mcap")
    with ended(subprocess.Popen(asked, cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)) as made:
        until((tmp_path / "there").exists, "the module")
        made.send_signal(number)
        _, line = made.communicate(timeout=60)
    assert made.returncode in (128 + number, 1 if what == "at its end" else 0) and made.returncode != 0
    assert line.count("hil: ") == 1 and "Traceback" not in line, line


def test_a_worker_of_a_sweep_that_is_ended_is_one_message(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(MODULE)
    done = subprocess.run(
        [HIL, "sweep", "dc-motor-hinf", "--metric", "mine:in_a_worker", "--set", "duration=5 s", "--runs", "400", "--jobs", "2"],
        cwd=tmp_path, capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert done.returncode == 2 and "Traceback" not in done.stderr, done.stderr
    assert "a worker process ended before its work was done" in done.stderr


@pytest.mark.realtime
def test_a_rig_that_a_module_ends_with_status_0_is_lost(tmp_path: Path) -> None:
    asked = command(tmp_path, f"def in_the_run(): {LEAVE}", "--clock", "real", "--link", "local:", "-o", "a.mcap", "--json")
    asked += ["--set", "duration=5 s"]
    done = subprocess.run(asked, cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert done.returncode == 1, done.stderr
    lost = json.loads(done.stdout)["problems"]["rig_lost"]
    assert lost.startswith("the rig process (pid ") and lost.endswith(") ended with status 0")


def test_a_pytest_is_not_ended_by_a_module(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(MODULE + "os._exit(0)\n")
    (tmp_path / "test_it.py").write_text(
        "def test_it(hil):\n    hil.run('dc-motor-hinf', plant={'kind': 'mine:Mine'}, duration='0.5 s')\n"
    )
    done = hil_command(*PYTEST[1:], cwd=tmp_path, program="pytest")
    assert done.returncode == 1 and "os._exit would end" in done.stdout, done.stdout


IN_C = {"ends": LEAVE, "closes": "[ctypes.CDLL(None).close(i) for i in range(4096)]"}
"""What the guide says of C code of a module, in a process that is not `hil`."""


@pytest.mark.parametrize(("what", "status"), [("ends", 0), ("closes", 1)])
def test_a_script_is_its_authors_and_ends_as_the_c_code_of_a_module_ends_it(what: str, status: int, tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(f"{MODULE}def at_start(): {IN_C[what]}\n")
    script = "import hil\nhil.run('dc-motor-hinf', plant={'kind': 'mine:Mine'}, duration='0.5 s')\nprint('behind it')"
    done = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert done.returncode == status and "behind it" not in done.stdout, (done.returncode, done.stderr)


def test_a_worker_of_pytest_that_c_code_of_a_module_ends_is_one_failed_test_and_the_others_run(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(f"{MODULE}def at_start(): {LEAVE}\n")
    (tmp_path / "test_it.py").write_text(
        "def test_it(hil):\n    hil.run('dc-motor-hinf', plant={'kind': 'mine:Mine'}, duration='0.5 s')\n"
        "def test_other(hil):\n    assert hil.run('dc-motor-hinf', duration='0.5 s').status == 0\n"
    )
    asked = [*PYTEST, "-n", "1", "-p", "no:cacheprovider"]
    done = subprocess.run(asked, cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert done.returncode == 1 and "1 failed, 1 passed" in done.stdout, done.stdout
    assert "crashed while running 'test_it.py::test_it'" in done.stdout, done.stdout


PRINTS = "print('words')\nos.write(1, b'bytes')\nsubprocess.run(['echo', 'child'])\nctypes.CDLL(None).puts(b'C')"


@pytest.mark.parametrize(
    ("name", "options"),
    [("run", ("-o", "a.mcap")), ("sweep", ("--runs", "2")), ("sweep", ("--runs", "2", "--grid", "plant.gain=150,160")),
     ("compare", ("dc-motor-h2", "--runs", "2")), ("laws", ())],
)  # fmt: skip
def test_json_is_one_document_whatever_a_module_prints(name: str, options: tuple[str, ...], tmp_path: Path) -> None:
    asked = command(tmp_path, PRINTS, *options, "--json", name=name)
    done = hil_command(*asked[1:], cwd=tmp_path, timeout=120)
    assert done.returncode == 0 and isinstance(json.loads(done.stdout), dict), (done.stdout, done.stderr)
    assert all(said in done.stderr for said in ("words", "bytes", "child"))
