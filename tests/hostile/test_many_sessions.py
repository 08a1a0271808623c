"""Many sessions, one after the other in one process; and faults at random instants: what is left, and what is lost."""

from __future__ import annotations

import gc
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import hil
from hil.errors import HilError
from hil.log.read.recover import recover
from hil.log.read.run import read_run
from tests.hostile.tally import Note
from tests.waiting import gone

pytestmark = [pytest.mark.hostile]

SESSIONS, WARM = 200, 20
MOST_KB = 4_000  # that 180 sessions may add: a tenth of a percent of what one session writes and reads
FAULTS = {"can:hil:{name}": 67, "zenoh:?name={name}": 67, "local:": 66}
SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT, signal.SIGSTOP, signal.SIGHUP)
ENDED = {0, 1, 2, 3, 6, 128 + signal.SIGINT, 128 + signal.SIGTERM, 128 + signal.SIGHUP, -signal.SIGKILL}


def _memory_kb() -> int:
    return int(Path("/proc/self/status").read_text().partition("VmRSS:")[2].split()[0])


def _descriptors() -> int:
    return len(os.listdir("/proc/self/fd"))


@pytest.mark.timeout(1800)
def test_two_hundred_sessions_in_one_process_leave_neither_memory_nor_descriptors(
    tmp_path: Path, record_property: Note
) -> None:
    experiment, failed = hil.load_experiment("dc-motor-hinf", duration=2), 0
    before: tuple[int, int] | None = None
    for number in range(SESSIONS):
        log = tmp_path / f"{number}.mcap"
        session = hil.run(experiment, log=log)
        failed += session.status != 0 or len(session.arrays["/plant/state"]) != 40
        log.unlink()
        if number == WARM - 1:
            gc.collect()
            before = _memory_kb(), _descriptors()
    gc.collect()
    assert before is not None
    grown_kb, more = _memory_kb() - before[0], _descriptors() - before[1]
    print(f"{SESSIONS} sessions: {grown_kb} kB and {more} descriptors more than after {WARM}")
    failed += (grown_kb > MOST_KB) + (more > 0)
    for name, value in (("attack", "sessions in one process"), ("tried", SESSIONS), ("failed", failed)):
        record_property(name, value)
    assert failed == 0


def _children(pid: int) -> list[int]:
    try:
        return [int(each) for each in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    except OSError:
        return []


def _fault(folder: Path, uri: str, draw: random.Random) -> str | None:
    """Run a session of three seconds, let one fault come at a random instant; return what is wrong afterwards."""
    log = folder / "x.mcap"
    command = ["run", "dc-motor-hinf", "--clock", "real", "--link", uri, "--duration", "3", "-o", str(log)]
    session = subprocess.Popen(
        [sys.executable, "-P", "-m", "hil", *command], cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        env=os.environ | {"HIL_CAN_DIR": str(folder / "c")},
    )  # fmt: skip
    while session.poll() is None and not log.exists():
        time.sleep(0.005)
    time.sleep(draw.uniform(0.0, 4.5))  # from before its children are there to behind its end
    pids = _children(session.pid)
    aim, number = draw.choice([session.pid, *pids]), draw.choice(SIGNALS)
    told = f"{signal.Signals(number).name} to {'the session' if aim == session.pid else 'a child'} over {uri}"
    try:
        os.kill(aim, number)
        if number == signal.SIGSTOP:
            time.sleep(draw.uniform(0.0, 1.5))
            os.kill(aim, signal.SIGCONT)
    except ProcessLookupError:
        pass
    try:
        _, said = session.communicate(timeout=60)
    except subprocess.TimeoutExpired:
        session.kill()
        return f"{told}: did not end"
    wrong = [] if session.returncode in ENDED else [f"status {session.returncode}"]
    wrong += ["a traceback"] if "Traceback" in said else []
    end = time.monotonic() + 10
    while time.monotonic() < end and not all(map(gone, pids)):
        time.sleep(0.05)
    wrong += [f"process {pid} is left" for pid in pids if not gone(pid)]
    if log.exists() and log.stat().st_size:
        try:
            try:
                read_run(log)
            except HilError:
                recover(log, folder / "r.mcap")
        except HilError as error:
            wrong += [str(error)]
    return f"{told}: {', '.join(wrong)}\n{said[-1500:]}" if wrong else None


@pytest.mark.timeout(3600)
@pytest.mark.parametrize("uri", FAULTS)
def test_faults_at_random_instants_leave_no_process_and_a_log_that_recovers(
    uri: str, tmp_path: Path, record_property: Note
) -> None:
    draw, failures = random.Random(f"faults {uri}"), []
    count = int(os.environ.get("HIL_FAULTS", FAULTS[uri]))
    for number in range(count):
        folder = tmp_path / str(number)
        (folder / "c").mkdir(parents=True, mode=0o700)
        (folder / "c").chmod(0o700)
        wrong = _fault(folder, uri.format(name=f"f{os.getpid()}-{number}"), draw)
        failures += [] if wrong is None else [wrong]
    attack = f"faults at random instants, {uri.partition(':')[0]}"
    for name, value in (("attack", attack), ("tried", count), ("failed", len(failures))):
        record_property(name, value)
    assert not failures, "\n".join(failures)
