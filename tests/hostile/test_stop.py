"""A stop on a machine with far more to do than it can: what runs the plant is gone within three seconds, and the log is whole."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from hil.log.read import read_run
from tests.waiting import gone, until

pytestmark = [pytest.mark.realtime, pytest.mark.hostile]

MOST_S = 3.0


@pytest.fixture(params=[0, 20], ids=["as it is", "load 20"])
def busy(request: pytest.FixtureRequest) -> Iterator[int]:
    """So many processes that compute without end."""
    started = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(request.param)]
    yield request.param
    for process in started:
        process.kill()
        process.wait()


@pytest.mark.timeout(300)
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_stop_takes_three_seconds_at_load_20_and_a_second_without(tmp_path: Path, number: int, busy: int) -> None:
    log = tmp_path / "run.mcap"
    session = subprocess.Popen(
        [sys.executable, "-m", "hil", "run", "dc-motor-hinf", "--clock", "real", "--link", f"can:hil:s{os.getpid()}",
         "--duration", "60", "-o", str(log)],
        cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        until(lambda: session.poll() is not None or (log.exists() and log.stat().st_size > 20_000), "the session")
        pids = [int(pid) for pid in Path(f"/proc/{session.pid}/task/{session.pid}/children").read_text().split()]
        assert len(pids) == 2  # rig and controller
        begun = time.monotonic()
        session.send_signal(number)
        for pid in pids:
            until(lambda pid=pid: gone(pid), "the end of what the session started")  # type: ignore[misc]
        ended_s = time.monotonic() - begun
        session.wait(120)
        print(f"with {busy} busy processes: rig and controller gone after {ended_s:.2f} s, "
              f"the summary written after {time.monotonic() - begun:.2f} s")  # fmt: skip
    finally:
        session.kill()
        session.wait()
    assert session.returncode == 128 + number and len(read_run(log).arrays["/plant/state"]) > 3
    assert ended_s < (MOST_S if busy else 1.0)
