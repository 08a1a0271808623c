"""Many sessions, one after the other in one process; and faults at random instants: what is left, and what is lost."""

from __future__ import annotations

import gc
import json
import os
import random
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

import hil
from hil.errors import HilError
from hil.log.read import read_run
from hil.log.read.recover import recover
from tests.hostile.faults import ENDED, GONE, Aim, children, fault
from tests.hostile.tally import Note
from tests.waiting import gone

pytestmark = [pytest.mark.hostile]

ROOT = Path(__file__).parents[2]
SESSIONS, WARM = 200, 20
MOST_KB = 4_000  # that 180 sessions may add: a tenth of a percent of what one session writes and reads
FAULTS = {"can:hil:{name}": 67, "zenoh:?name={name}": 67, "local:": 66}


def _memory_kb() -> int:
    return int(Path("/proc/self/status").read_text().partition("VmRSS:")[2].split()[0])


def _descriptors() -> int:
    return len(os.listdir("/proc/self/fd"))


def run_many(folder: Path) -> dict[str, int]:
    """Run the sessions in this process; return how many failed, and what memory and descriptors grew by since the first few."""
    experiment, failed = hil.load_experiment("dc-motor-hinf", duration=2), 0
    before = 0, 0
    for number in range(SESSIONS):
        log = folder / f"{number}.mcap"
        session = hil.run(experiment, log=log)
        failed += session.status != 0 or len(session.arrays["/plant/state"]) != 40
        log.unlink()
        if number == WARM - 1:
            gc.collect()
            before = _memory_kb(), _descriptors()
    gc.collect()
    return {"failed": failed, "kB": _memory_kb() - before[0], "descriptors": _descriptors() - before[1]}


@pytest.mark.timeout(1800)
def test_two_hundred_sessions_in_one_process_leave_neither_memory_nor_descriptors(
    tmp_path: Path, record_property: Note
) -> None:
    """A process of their own: what other tests left in this one would come and go among them."""
    program = "import json, pathlib, sys; from tests.hostile.test_many_sessions import run_many\n"
    program += "print(json.dumps(run_many(pathlib.Path(sys.argv[1]))))"
    words = [sys.executable, "-c", program, str(tmp_path)]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True)
    print(done.stdout)
    found = json.loads(done.stdout)
    failed = found["failed"] + (found["kB"] > MOST_KB) + (found["descriptors"] > 0)
    for name, value in (("attack", "sessions in one process"), ("tried", SESSIONS), ("failed", failed)):
        record_property(name, value)
    assert failed == 0


REAL = {"local:": 67, "can:hil:{name}": 67, "zenoh:?name={name}": 66}
REAL_WARM = 6


@pytest.mark.realtime
@pytest.mark.timeout(5400)
@pytest.mark.parametrize("uri", REAL)
def test_two_hundred_sessions_in_real_time_leave_neither_memory_descriptors_nor_files(
    uri: str, tmp_path: Path, record_property: Note, monkeypatch: pytest.MonkeyPatch
) -> None:
    """This process keeps the log of each; rig and controller are processes that end."""
    (tmp_path / "c").mkdir(mode=0o700)
    monkeypatch.setenv("HIL_CAN_DIR", str(tmp_path / "c"))
    count, failed = int(os.environ.get("HIL_SESSIONS", REAL[uri])), 0
    experiment = hil.load_experiment("dc-motor-hinf", duration=0.25, **{"limits.watchdog_slots": 1000})
    before: tuple[int, int, int] | None = None
    for number in range(count):
        log = tmp_path / f"{number}.mcap"
        session = hil.run(experiment, clock="real", link=uri.format(name=f"m{os.getpid()}"), log=log)
        failed += session.status != 0 or len(session.arrays["/plant/state"]) != 5
        log.unlink()
        if number == REAL_WARM - 1:
            gc.collect()
            before = _memory_kb(), _descriptors(), threading.active_count()
    gc.collect()
    assert before is not None
    grown_kb, more, threads = _memory_kb() - before[0], _descriptors() - before[1], threading.active_count() - before[2]
    left = [*(tmp_path / "c").iterdir(), *children(os.getpid())]
    print(f"{count} sessions over {uri}: {grown_kb} kB, {more} descriptors, {threads} threads more than after {REAL_WARM}")
    failed += (grown_kb > MOST_KB) + (more > 0) + (threads > 0) + bool(left)
    for name, value in (("attack", "sessions in one process"), ("tried", count), ("failed", failed)):
        record_property(name, value)
    assert failed == 0, (grown_kb, more, threads, left)


def _fault(folder: Path, uri: str, draw: random.Random) -> str | None:
    """Run a session of three seconds, let one fault come at a random instant; return what is wrong afterwards."""
    log = folder / "x.mcap"
    command = ["run", "dc-motor-hinf", "--clock", "real", "--link", uri, "--duration", "3", "-o", str(log)]
    session = subprocess.Popen(
        [sys.executable, "-P", "-m", "hil", *command], cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    while session.poll() is None and not log.exists():
        time.sleep(0.005)
    time.sleep(draw.uniform(0.0, 4.5))  # from before its children are there to behind its end
    pids = children(session.pid)
    reported = fault(Aim(folder=folder, uri=uri, session=session.pid, draw=draw))
    try:
        _, said = session.communicate(timeout=60)
    except subprocess.TimeoutExpired:
        session.kill()
        return f"{reported}: did not end"
    wrong = [] if session.returncode in ENDED else [f"status {session.returncode}"]
    wrong += ["a traceback"] if "Traceback" in said else []
    end = time.monotonic() + 10
    while time.monotonic() < end and not all(map(gone, pids)):
        time.sleep(0.05)
    wrong += [f"process {pid} is left" for pid in pids if not gone(pid)]
    if not reported.startswith(GONE) and log.exists() and log.stat().st_size:
        try:
            try:
                read_run(log)
            except HilError:
                recover(log, folder / "r.mcap")
        except HilError as error:
            wrong += [str(error)]
    return f"{reported}: {', '.join(wrong)}\n{said[-1500:]}" if wrong else None


@pytest.mark.timeout(3600)
@pytest.mark.parametrize("uri", FAULTS)
def test_faults_at_random_instants_leave_no_process_and_a_log_that_recovers(
    uri: str, tmp_path: Path, record_property: Note, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "c").mkdir(mode=0o700)
    monkeypatch.setenv("HIL_CAN_DIR", str(tmp_path / "c"))
    draw, failures = random.Random(f"faults {uri}"), []
    count = int(os.environ.get("HIL_FAULTS", FAULTS[uri]))
    for number in range(count):
        folder = tmp_path / str(number)
        folder.mkdir()
        wrong = _fault(folder, uri.format(name=f"f{os.getpid()}-{number}"), draw)
        failures += [] if wrong is None else [wrong]
    attack = f"faults at random instants, {uri.partition(':')[0]}"
    for name, value in (("attack", attack), ("tried", count), ("failed", len(failures))):
        record_property(name, value)
    assert not failures, "\n".join(failures)
