"""Units that fail, loop, crash, leave or print: one message, a whole log, and nothing left behind."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
import zipfile
from pathlib import Path
from typing import Any

import pytest

import hil
from hil.experiment import shipped
from hil.log.read import read_run
from plants import FMU
from plants.fmu_host import PREFIX, remove_left_behind
from tests.plants.fmu.test_fmu import CART, LINEAR, REAL, RUN, SOURCE, VERSION_2
from tests.waiting import ended, gone, until
from tests.warm_hil import hil_command

pytest.importorskip("fmpy", reason="FMPy is not installed: pip install 'hilrig[fmu]'")
pytestmark = pytest.mark.skipif(
    shutil.which("cc") is None or sys.platform != "linux", reason="a unit is made by the C compiler: apt-get install gcc"
)
HEADERS = "#include <signal.h>\n#include <stdio.h>\n#include <stdlib.h>\n#include <unistd.h>\n"
STEP = "int fmi2DoStep(void *c, double t, double h, int no) {"
LOADED = "__attribute__((constructor)) static void loaded(void) { %s }\n"
SEGFAULT = "*(volatile int *)0 = 1;"


def unit(
    folder: Path, *, late: str = "", loaded: str = "", variables: int = 0, files: int = 0, zeros: int = 0, library: str = "cart"
) -> str:
    """Make bad.fmu: the cart, with code that runs from 0.6 s on, or when its library is loaded."""
    from fmpy.fmi2 import FMU2Slave
    from fmpy.fmi3 import FMU3Slave

    asked = {name for cls in (FMU2Slave, FMU3Slave) for name in dir(cls) if re.match("fmi[23][A-Z]", name)}
    source = HEADERS + SOURCE.replace(STEP, f"{STEP} if (t > 0.55) {{ {late} }}") + (LOADED % loaded if loaded else "")
    rest = "".join(f"int {name}(void) {{ return 3; }}\n" for name in sorted(asked) if f"{name}(" not in source)
    (folder / "bad.c").write_text(source + rest)
    subprocess.run(["cc", "-shared", "-fPIC", "-O0", "-w", "-o", folder / "bad.so", folder / "bad.c"], check=True)
    more = [(f"v{i}", i + 9, "local", "", "") for i in range(variables)]
    with zipfile.ZipFile(folder / "bad.fmu", "w", zipfile.ZIP_DEFLATED) as file:
        described = VERSION_2.format(variables="".join(REAL.format(*v) for v in (*CART, *more)))
        file.writestr("modelDescription.xml", described.replace('modelIdentifier="cart"', f'modelIdentifier="{library}"'))
        file.write(folder / "bad.so", "binaries/linux64/cart.so")
        for i in range(files):
            file.writestr(f"resources/{i}", b"")
        if zeros:
            file.writestr("resources/zeros", bytes(zeros))
    plant = f'[plant]\nkind = "fmu"\nfile = "bad.fmu"\nA = {LINEAR["A"]}\nB = {LINEAR["B"]}\nC = {LINEAR["C"]}\n'
    motor = shipped()["dc-motor-hinf"].read_text().replace('[plant]\nkind = "dc-motor"\n', plant)
    motor = re.sub(r"\[controller\]\n(.*\n)*?\n", '[controller]\nkind = "local"\ngain = [[-0.4]]\n\n', motor)
    motor = motor.replace("seed = 0", "seed = 0\nallow_uncertified = true")
    (folder / "exp.toml").write_text(re.sub(r"state = \{.*\}", "", motor))
    return str(folder / "exp.toml")


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """TMPDIR of this test and of what it starts."""
    folder = tmp_path / "tmp"
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", str(folder))
    return folder


def command(folder: Path, *words: str) -> list[str]:
    return ["run", str(folder / "exp.toml"), "--duration", "2s", "--json", "-o", str(folder / "a.mcap"), *words]


def started(words: list[str], stdout: int = subprocess.PIPE) -> subprocess.Popen[str]:
    return subprocess.Popen([sys.executable, "-m", "hil", *words], stdout=stdout, stderr=subprocess.PIPE, text=True)


def left(temporary: Path, patience_s: float = 20.0, *, by_the_next: bool = False) -> list[str]:
    """Return which folders of units are left; the process that removes them, or the next that begins, may need a moment."""
    end = time.monotonic() + patience_s
    while (found := [p.name for p in temporary.iterdir() if p.name.startswith(PREFIX)]) and time.monotonic() < end:
        if by_the_next:
            remove_left_behind(str(temporary))
        time.sleep(0.02)
    return found


@pytest.mark.parametrize(
    ("late", "reported"),
    [
        ("return 3;", "the unit failed in the step to 0.65 s: FMICallException: fmi2DoStep failed with status 3 (error)"),
        (SEGFAULT, "the unit was killed by SIGSEGV in the step to 0.65 s"),
        ("exit(0);", "the unit ended its process with status 0 in the step to 0.65 s"),
        ("for (int i = 0; i < 100; i++) close(i);", "the unit "),
        ("kill(getppid(), 9); sleep(60);", "the process that holds the unit is gone"),
        ('for (int i = 3; i < 64; i++) write(i, "\\0\\0\\0\\10AAAAAAAA", 12);', "answered 8 bytes that are no values"),
    ],
)
def test_a_unit_that_fails_in_a_step_is_one_message_and_a_whole_log(
    tmp_path: Path, temporary: Path, late: str, reported: str
) -> None:
    unit(tmp_path, late=late)
    done = hil_command(*command(tmp_path), cwd=tmp_path)
    summary = json.loads(done.stdout)
    assert done.returncode == 1 and reported in summary["problems"]["plant_failed"] and "Traceback" not in done.stderr
    run = read_run(tmp_path / "a.mcap")  # whole: closed, with its index
    assert len(run.arrays["/plant/state"]) == summary["slots"] >= 12
    assert [event["message"] for event in run.events if event["kind"] == "plant failed"] == [summary["problems"]["plant_failed"]]
    by_the_next = "getppid" in late  # who would remove it is gone, and the unit, which dies with it, may still hold its lock
    assert not left(temporary, by_the_next=by_the_next)


@pytest.mark.parametrize("started", ["%s", "setsid(); if (!fork()) { %s }"], ids=["a child", "a session of its own"])
def test_what_a_unit_starts_and_leaves_ends_with_the_session(tmp_path: Path, temporary: Path, started: str) -> None:
    note = f'FILE *f = fopen("{tmp_path}/pid", "w"); fprintf(f, "%d", getpid()); fclose(f); sleep(1000);'
    unit(tmp_path, late=f"static int n = 0; if (!n++ && !fork()) {{ {started % note} _exit(0); }}")
    done = hil_command(*command(tmp_path), cwd=tmp_path)
    pid = int((tmp_path / "pid").read_text())
    assert done.returncode == 0
    until(lambda: gone(pid), "the end of what the unit started")


@pytest.mark.realtime
def test_in_real_time_a_unit_that_kills_its_host_while_it_is_warmed_up_is_one_message(tmp_path: Path, temporary: Path) -> None:
    unit(tmp_path, late="kill(getppid(), 9); sleep(60);")
    words = command(tmp_path, "--clock", "real", "--link", "local:")
    done = hil_command(*words, cwd=tmp_path)
    assert done.returncode in (1, 2) and "the process that holds the unit is gone" in done.stderr + done.stdout
    assert "Traceback" not in done.stderr, done.stderr


@pytest.mark.parametrize(
    ("late", "number"),
    [
        ("for (;;);", signal.SIGINT),
        ("for (int i = 1; i < 65; i++) signal(i, SIG_IGN); for (;;) sleep(1);", signal.SIGTERM),
    ],
)
def test_a_unit_without_an_end_is_ended_by_a_signal(tmp_path: Path, temporary: Path, late: str, number: int) -> None:
    unit(tmp_path, late=f'fputs("loops\\n", stderr); {late}')
    with ended(started(command(tmp_path))) as process:
        assert process.stderr is not None and process.stderr.readline() == "loops\n"
        process.send_signal(number)
        out, err = process.communicate(timeout=60)
    assert process.returncode == 128 + number and "Traceback" not in err
    assert json.loads(out)["problems"] == {"interrupted": signal.Signals(number).name}
    assert len(read_run(tmp_path / "a.mcap").arrays["/plant/state"]) >= 12 and not left(temporary)


@pytest.mark.parametrize(
    ("bad", "reported"),
    [
        ({"loaded": SEGFAULT}, "cannot be started: the unit was killed by SIGSEGV while it started"),
        ({"loaded": "_exit(0);"}, "cannot be started: the unit ended its process with status 0"),
        ({"variables": 60_000}, "its modelDescription.xml has 60005 variables; at most 50000"),
        ({"files": 2_000}, "unpacks to 2002 files"),
        ({"zeros": 100_000_000}, "at most 2000 and 16777216"),
        ({"library": "../.."}, "modelIdentifier '../..' is no name of a library"),
    ],
)
def test_a_unit_that_is_none_is_refused_before_anything_runs(
    tmp_path: Path, temporary: Path, bad: dict[str, Any], reported: str
) -> None:
    with pytest.raises(hil.HilError, match=re.escape(reported)):
        hil.load_experiment(unit(tmp_path, **bad))


def test_what_a_unit_prints_stays_out_of_our_output(tmp_path: Path, temporary: Path) -> None:
    unit(tmp_path, late='puts("{}"); fflush(stdout); write(1, "x\\n", 2);')
    done = hil_command(*command(tmp_path), cwd=tmp_path)
    assert done.returncode == 0 and json.loads(done.stdout)["slots"] == 40 and "{}\nx\n" in done.stderr


def test_the_folder_of_a_killed_session_goes_with_it(tmp_path: Path, temporary: Path) -> None:
    unit(tmp_path, late='fputs("loops\\n", stderr); for (;;) sleep(1);')
    with ended(started(command(tmp_path), subprocess.DEVNULL)) as process:
        assert process.stderr is not None and process.stderr.readline() == "loops\n"
        assert any(p.name.startswith(PREFIX) for p in temporary.iterdir())
        process.kill()
    assert not left(temporary)


def test_what_a_killed_host_left_is_removed_by_the_next_and_what_runs_is_not(tmp_path: Path, temporary: Path) -> None:
    from plants.fmu_run import FMURun, Host

    unit(tmp_path)
    plant = FMU(file="bad.fmu", **LINEAR).with_files(str(tmp_path))
    host = Host(plant.unit)
    folders = {p for p in temporary.iterdir() if p.name.startswith(PREFIX)}
    remove_left_behind(str(temporary))
    assert folders and all(p.exists() for p in folders)  # they have their hosts
    os.kill(host._process, signal.SIGKILL)
    end = time.monotonic() + 20.0
    while {p for p in folders if p.exists()} == folders and time.monotonic() < end:
        remove_left_behind(str(temporary))
        time.sleep(0.02)
    assert len({p for p in folders if p.exists()}) == len(folders) - 1
    assert isinstance(plant.start(None), FMURun)  # type: ignore[arg-type]  # the other host serves on


def test_the_same_seed_gives_the_same_log(tmp_path: Path, temporary: Path) -> None:
    experiment = unit(tmp_path)
    given = {**RUN, "plant": {"kind": "fmu", "file": "bad.fmu", **LINEAR}}
    sessions = [hil.run(experiment, log=tmp_path / f"{n}.mcap", **given) for n in "ab"]
    assert sessions[0].summary["log"]["sha256"] == sessions[1].summary["log"]["sha256"]


@pytest.mark.realtime
def test_in_real_time_a_unit_that_crashes_ends_the_session_in_order(tmp_path: Path, temporary: Path) -> None:
    unit(tmp_path, late=f'if (!access("{tmp_path}/go", 0)) {{ {SEGFAULT} }}')  # rehearsals are behind it then
    words = command(tmp_path, "--clock", "real", "--link", "local:", "--duration", "60s")
    with ended(started(words)) as process:
        log = tmp_path / "a.mcap"
        until(lambda: log.exists() and log.stat().st_size > 0, "the log is begun")
        begun = log.stat().st_size
        until(lambda: log.stat().st_size > begun + 2000, "the rig runs")
        (tmp_path / "go").touch()
        out, err = process.communicate(timeout=120)
    summary = json.loads(out)
    assert process.returncode == 1 and "Traceback" not in err
    assert "killed by SIGSEGV" in next(e["message"] for e in read_run(log).events if e["kind"] == "plant failed")
    assert "SIGSEGV" in summary["problems"]["plant_failed"] and not left(temporary)


@pytest.mark.parametrize(("ends", "status"), [("os._exit(7)", 7), ("os.kill(os.getpid(), signal.SIGKILL)", -9)])
def test_a_runner_that_no_longer_answers_has_the_time_to_end_by_itself(ends: str, status: int) -> None:
    """A process of the host's own, without a unit: it ends a tenth of a second later, or has ended before."""
    for pause in ("time.sleep(0.1); ", ""):
        code = (
            "import os, signal, time\n"
            "from plants.fmu_host import _how\n"
            "pid = os.fork()\n"
            f"if pid == 0: {pause}{ends}\n"
            "runners = {pid: None}\n"
            "print(_how(pid, runners), _how(pid, runners))\n"
        )
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
        assert done.stdout.split() == [str(status)] * 2, done.stderr
