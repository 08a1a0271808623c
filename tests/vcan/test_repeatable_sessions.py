"""Two machines, one log: sessions of two processes over vcan0 in virtual time, in two kernels."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from hil.log.read import read_run

URIS = {"fd": "can:socketcan:vcan0", "classic": "can:socketcan:vcan0?fd=0"}
SESSIONS = f"""
import sys
import hil
for name, link in {URIS}.items():
    session = hil.run("dc-motor-hinf", clock="real", link=link, duration=10, log=f"{{sys.argv[1]}}/{{name}}.mcap")
    assert session.status == 0 and session.summary["timing"]["valid"], session.summary
"""


@pytest.mark.usefixtures("boots_kernels")
def test_two_virtual_time_sessions_write_the_same_records(tmp_path: Path) -> None:
    """Every value, every measured lateness and round trip, every time stamp.

    Only nonces and echoes, 8 bytes of each frame, are drawn anew for every session, and with them its checksum.
    """
    kernels = tmp_path / "one", tmp_path / "two"
    for folder in kernels:
        folder.mkdir()
        vcan = [sys.executable, "-m", "hil", "vcan", "--virtual-time", "--rw", str(folder), "--"]
        command = [*vcan, sys.executable, "-c", SESSIONS, str(folder)]
        done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr
    for link in URIS:
        first, second = (read_run(folder / f"{link}.mcap").arrays for folder in kernels)
        assert first.keys() == second.keys()
        for topic, rows in first.items():
            for name in set(rows.dtype.names) - {"data"}:
                assert rows[name].tobytes() == second[topic][name].tobytes(), (link, topic, name)
            if "data" in rows.dtype.names:
                assert [frame[4:8] + frame[16:] for frame in map(bytes, rows["data"])] == [
                    frame[4:8] + frame[16:] for frame in map(bytes, second[topic]["data"])
                ]
