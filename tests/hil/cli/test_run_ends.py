"""How a run ends that is not left in peace: signals early and late, two runs on one file, links, plug-ins that fail."""

from __future__ import annotations

import fcntl
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import hil
from hil.cli.run import let_go
from hil.experiment import shipped
from hil.log.read import read_run
from tests.hil.cli.conftest import Hil
from tests.onlooker import Looks
from tests.waiting import gone, until
from tests.warm_hil import hil_command

PLANT = '''
import os
import sys
from dataclasses import dataclass
from typing import ClassVar
from plants import LinearRun, Signal, StateSpace
from tests.warm_hil import hil_command

class Base(BaseException):
    pass

class Run:
    slots = 0
    def __init__(self, linear):
        self.linear = linear
    def __getattr__(self, name):
        return getattr(self.linear, name)
    def advance(self, dt_ns, u, w=()):
        Run.slots += {begun}  # behind all checks
        if Run.slots > 20:
            {late}
        self.linear.advance(dt_ns, u, w)

@dataclass(frozen=True)
class Cart:
    inputs: ClassVar = (Signal("force", "N"),)
    outputs: ClassVar = (Signal("speed", "m/s"),)
    states: ClassVar = (Signal("speed", "m/s"),)
    def model(self):
        return StateSpace(A=[[-1.0]], B=[[1.0]], C=[[1.0]])
    def start(self, rng):
        return Run(LinearRun(self.model(), (0.0,)))
'''
WORDS = ("--set", 'plant={kind="cart:Cart"}', "--set", "limits.state={}", "--set", "allow_uncertified=true", "--duration", "3",
         "--json")  # fmt: skip


def prepared(folder: Path, late: str) -> list[str]:
    log = str(folder / "a.mcap")
    begun = f"os.path.exists({log!r}) and os.path.getsize({log!r}) > 0"
    (folder / "cart.py").write_text(PLANT.replace("{late}", late).replace("{begun}", begun))
    (folder / "exp.toml").write_text(shipped()["dc-motor-hinf"].read_text())
    return ["run", str(folder / "exp.toml"), "-o", str(folder / "a.mcap"), *WORDS]


@pytest.mark.parametrize("late", ["return {}['x']", "raise Base('not now')", "sys.exit(0)"])
def test_a_plug_in_that_fails_in_mid_run_is_one_message_and_a_whole_log(tmp_path: Path, late: str) -> None:
    done = hil_command(*prepared(tmp_path, late), cwd=tmp_path)
    assert done.returncode == 1 and "Traceback" not in done.stderr, done.stderr
    problem = json.loads(done.stdout)["problems"]["plug_in_failed"]
    assert f"{tmp_path}/cart.py, line " in problem and problem.startswith(("KeyError", "Base", "SystemExit"))
    run = read_run(tmp_path / "a.mcap")
    assert [e["message"] for e in run.events if e["kind"] == "plug in failed"] == [problem]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT])
def test_a_plug_in_that_never_returns_is_ended_by_a_signal_with_its_log(tmp_path: Path, number: int) -> None:
    late = f"import time\n            os.kill(os.getpid(), {int(number)})\n            while True: time.sleep(0.01)"
    done = hil_command(*prepared(tmp_path, late), cwd=tmp_path, timeout=60)
    assert done.returncode == 128 + number and "Traceback" not in done.stderr
    assert json.loads(done.stdout)["problems"] == {"interrupted": signal.Signals(number).name}
    assert read_run(tmp_path / "a.mcap").events[-1]["kind"] == "outcome"


def test_what_prints_where_no_stream_is_open_writes_into_no_file(tmp_path: Path) -> None:
    """Without `hil`'s standard streams, which who started it has closed, the log would be one of them."""
    words = prepared(tmp_path, "os.write(1, b'words')")[:-1]  # --json would be refused
    command = ["sh", "-c", 'exec "$@" <&- >&- 2>&-', "sh", sys.executable, "-m", "hil", *words]
    assert subprocess.run(command, cwd=tmp_path).returncode == 0
    assert read_run(tmp_path / "a.mcap").events[-1]["kind"] == "outcome" and b"words" not in (tmp_path / "a.mcap").read_bytes()


STOPPED = """
import os, signal, time
os.kill(os.getppid(), signal.SIGTERM)
time.sleep(60)
"""


def test_a_signal_to_the_process_that_was_called_reaches_that_of_ones_own_module(tmp_path: Path) -> None:
    (tmp_path / "stopped.py").write_text(STOPPED)
    done = hil_command("list", "plants", "stopped:Plant", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (143, "\nhil: interrupted\n"), "it heeds the signal, and is not killed"


ORPHAN = """
import os, signal, time
parent = os.getppid()
open("pid", "w").write(str(os.getpid()))
os.kill(parent, signal.SIGKILL)
while os.getppid() == parent:
    pass
time.sleep(1)
open("alive", "w").close()
"""


def test_a_command_of_ones_own_module_ends_with_the_process_that_was_called(tmp_path: Path) -> None:
    (tmp_path / "orphan.py").write_text(ORPHAN)
    assert hil_command("list", "plants", "orphan:Plant", cwd=tmp_path).returncode == -signal.SIGKILL
    until(lambda: gone(int((tmp_path / "pid").read_text())), "the end of the process in which the module runs")
    assert not (tmp_path / "alive").exists()


def test_a_signal_before_the_first_record_leaves_no_empty_log(tmp_path: Path) -> None:
    words = prepared(tmp_path, "pass")
    text = (tmp_path / "cart.py").read_text()
    late = "    def model(self):\n        if os.path.exists({log!r}): print('taken', file=sys.stderr); os.kill(os.getpid(), 2)\n"
    (tmp_path / "cart.py").write_text(text.replace("    def model(self):\n", late.format(log=str(tmp_path / "a.mcap"))))
    done = hil_command(*words, cwd=tmp_path)
    assert done.returncode == 130 and "Traceback" not in done.stderr and done.stderr.startswith("taken\n")
    assert not (tmp_path / "a.mcap").exists()


def test_what_another_run_has_begun_is_not_removed(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with open(path, "wb") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        let_go(path)
        assert path.exists()
    let_go(path)
    assert not path.exists()


def test_two_runs_never_write_one_file(tmp_path: Path, cli: Hil) -> None:
    assert cli("run", "dc-motor-hinf", "--duration", "1s", "-o", "a.mcap")[0] == 0
    before = (tmp_path / "a.mcap").read_bytes()
    with open(tmp_path / "a.mcap", "rb") as file:
        fcntl.flock(file, fcntl.LOCK_EX)  # as a run does while it writes
        status, _, err = cli("run", "dc-motor-hinf", "--duration", "1s", "-o", "a.mcap", "--force")
    assert status == 2 and "another run is writing it" in err and (tmp_path / "a.mcap").read_bytes() == before
    assert cli("run", "dc-motor-hinf", "--duration", "1s", "-o", "a.mcap", "--force")[0] == 0


def test_a_run_holds_its_log_while_it_writes(tmp_path: Path) -> None:
    seen = []

    def look(t_ns: int, payload: bytes) -> None:
        if not seen:
            with open(tmp_path / "a.mcap", "rb") as file:
                try:
                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    seen.append(False)
                except BlockingIOError:
                    seen.append(True)

    from hil.session import run_session

    run_session(
        hil.load_experiment("dc-motor-hinf", duration=1), path=tmp_path / "a.mcap", onlooker=Looks({"/plant/state": look})
    )
    assert seen == [True]


def test_force_goes_through_no_link(tmp_path: Path, cli: Hil) -> None:
    (tmp_path / "victim.txt").write_text("mine")
    (tmp_path / "l.mcap").symlink_to("victim.txt")
    status, out, err = cli("run", "dc-motor-hinf", "--duration", "1s", "-o", "l.mcap", "--force")
    assert (status, out) == (2, "") and f"is a symbolic link, and --force overwrites no file through one; name {tmp_path}" in err
    assert (tmp_path / "victim.txt").read_text() == "mine" and (tmp_path / "l.mcap").is_symlink()
    (tmp_path / "loop").symlink_to("loop")
    err = cli("run", "dc-motor-hinf", "--duration", "1s", "-o", "loop/a/b.mcap", "--force")[2]
    assert "log loop/a/b.mcap: cannot be created: Too many levels of symbolic links" in err
    with pytest.raises(hil.HilError, match=r"l\.mcap: exists already"):
        hil.run("dc-motor-hinf", duration=1, log=tmp_path / "l.mcap")


def test_a_reader_of_json_that_has_left_is_reported_like_one_of_a_table(tmp_path: Path) -> None:
    for words in (["list", "--json"], ["laws", "dc-motor-hinf"]):
        done = hil_command(*words, cwd=tmp_path, reader_left=True)
        assert (done.returncode, done.stderr) == (141, "")


def test_json_for_a_closed_output_runs_nothing(tmp_path: Path) -> None:
    words = f"{sys.executable} -m hil run dc-motor-hinf --duration 1 -o a.mcap --json >&-"
    done = subprocess.run(["sh", "-c", words], cwd=tmp_path, stderr=subprocess.PIPE, text=True)
    assert done.returncode == 2 and "--json writes to standard output, which is closed" in done.stderr
    assert not (tmp_path / "a.mcap").exists()


@pytest.mark.parametrize("word", ["list", "guide"])
def test_a_command_that_only_prints_says_that_its_output_is_closed(word: str, tmp_path: Path) -> None:
    words = f"{sys.executable} -m hil {word} >&-"
    done = subprocess.run(["sh", "-c", words], cwd=tmp_path, stderr=subprocess.PIPE, text=True)
    said = f"hil: {word} writes to standard output, which is closed; nothing was run\n"
    assert (done.returncode, done.stderr) == (2, said)


def test_a_working_folder_that_is_gone_is_said(tmp_path: Path) -> None:
    (tmp_path / "gone").mkdir()
    words = f"cd {tmp_path}/gone; rmdir {tmp_path}/gone; exec {sys.executable} -m hil run e.toml"
    done = subprocess.run(["sh", "-c", words], env={**os.environ, "PYTHONPATH": str(Path.cwd())}, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (2, "hil: the working folder is gone; change to one that is there\n")


def test_a_fault_of_the_machine_is_one_line(tmp_path: Path) -> None:
    words = f"{sys.executable} -m hil list 1< /dev/null"  # standard output that cannot be written
    done = subprocess.run(["sh", "-c", words], cwd=tmp_path, stderr=subprocess.PIPE, text=True)
    assert (done.returncode, done.stderr) == (1, "hil: standard output or a file: Bad file descriptor\n")
    (tmp_path / "tomllib.py").write_text('raise ImportError("advice\\n\\nlibx.so: failed to map segment")')  # as memory runs out
    paths = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}
    done = subprocess.run(
        [sys.executable, "-m", "hil", "laws", "dc-motor-hinf"], env=paths, capture_output=True, text=True, cwd=tmp_path
    )
    assert (done.returncode, done.stderr) == (1, "hil: a library cannot be loaded: libx.so: failed to map segment\n")


@pytest.mark.parametrize("in_a_library", [False, True])
def test_an_interrupt_outside_a_command_is_one_line(in_a_library: bool, monkeypatch: pytest.MonkeyPatch, cli: Hil) -> None:
    """One comes behind its last line, or while a library in C begins: pybind11 raises an ImportError of it."""
    from hil.cli import cli as group

    def late(*_: object, **__: object) -> None:
        if in_a_library:
            raise ImportError("initialization failed") from KeyboardInterrupt()
        raise KeyboardInterrupt

    monkeypatch.setattr(group, "main", late)
    assert cli("list")[::2] == (130, "\nhil: interrupted\n")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_while_the_log_is_made_leaves_none(
    number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Hil
) -> None:
    """The signal comes between the making of the file and the return of its name."""

    def made(output: Path, *_rest: object) -> Path:
        output.touch()
        os.kill(os.getpid(), number)
        return output

    monkeypatch.setattr("hil.cli.run.reserve", made)
    monkeypatch.chdir(tmp_path)
    status, _, err = cli("run", "dc-motor-hinf", "--duration", "1", "-o", "a.mcap")
    assert status == 128 + number and "interrupted" in err and not list(tmp_path.iterdir())


def test_what_a_module_of_ones_own_prints_stays_out_of_the_json(tmp_path: Path) -> None:
    text = shipped()["dc-motor-hinf"].read_text().replace('kind = "hinf"', 'kind = "loud:Loud"')
    (tmp_path / "e.toml").write_text(text)
    (tmp_path / "loud.py").write_text(
        "from dataclasses import dataclass\nfrom design.controllers import Constant\nprint('imported')\n"
        "@dataclass(frozen=True, kw_only=True)\nclass Loud(Constant):\n    value: tuple[float, ...] = (0.0,)\n"
        "    def __post_init__(self):\n        print('{}')\n"
    )
    words = ("run", "e.toml", "--duration", "1", "--json", "-o", "x.mcap", "--set", "allow_uncertified=true")
    done = hil_command(*words, cwd=tmp_path)
    assert json.loads(done.stdout)["slots"] == 20, done.stderr
    assert done.stderr.startswith("imported\n{}\n")


@pytest.mark.parametrize("command", ["run", "live"])
def test_a_log_that_cannot_be_is_refused_before_anything_else(cli: Hil, command: str) -> None:
    status, out, err = cli(command, "dc-motor-hinf", "--duration", "1", "-o", "/proc/run.mcap")
    assert (status, out) == (2, "")
    assert err.startswith("hil: log /proc/run.mcap: cannot be created: ") and err.endswith("; -o names a file elsewhere\n")
    assert err.count("\n") == 1, "no address of a page that never is"
