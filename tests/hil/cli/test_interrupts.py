"""A signal is raised as an exception in the main thread, never inside an import, where somebody may swallow it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

SWALLOWS = """
import time
print("importing", flush=True)
end = time.monotonic() + {seconds}
while time.monotonic() < end:
    try:
        time.sleep(end - time.monotonic())
    except BaseException:
        print("swallowed", flush=True)
"""
WAITS = """
import time
from hil.cli.interrupts import Terminated, signals_as_exceptions
try:
    with signals_as_exceptions():
        import swallows
        time.sleep(60)
except Terminated as e:
    raise SystemExit(e.status)
except KeyboardInterrupt:
    raise SystemExit(130)
"""


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)])
@pytest.mark.parametrize("signals", [1, 3])
def test_a_signal_inside_an_import_is_raised_after_it(tmp_path: Path, number: int, status: int, signals: int) -> None:
    (tmp_path / "swallows.py").write_text(SWALLOWS.format(seconds=0.3))
    path = {"PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}
    with subprocess.Popen([sys.executable, "-c", WAITS], stdout=subprocess.PIPE, text=True, env=os.environ | path) as process:
        assert process.stdout is not None and process.stdout.readline() == "importing\n"
        for _ in range(signals):
            process.send_signal(number)
            time.sleep(0.02)
        assert process.communicate(timeout=120)[0] == ""
    assert process.returncode == status


def test_an_import_without_an_end_is_ended(tmp_path: Path) -> None:
    (tmp_path / "swallows.py").write_text(SWALLOWS.format(seconds=30))
    path = {"PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}
    with subprocess.Popen([sys.executable, "-c", WAITS], stdout=subprocess.PIPE, text=True, env=os.environ | path) as process:
        assert process.stdout is not None and process.stdout.readline() == "importing\n"
        process.send_signal(signal.SIGINT)
        assert process.stdout.readline() == "swallowed\n"  # it was raised there, where this one passes over it
        process.kill()
