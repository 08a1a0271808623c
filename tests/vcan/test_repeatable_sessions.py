"""Two machines, one log: sessions of two processes over vcan0 in virtual time, each in a kernel of its own."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from hil.log.read import read_run

RUNNER = [sys.executable, "-m", "hil", "vcan"]


@pytest.mark.usefixtures("boots_kernels")
@pytest.mark.parametrize("uri", ["can:socketcan:vcan0", "can:socketcan:vcan0?fd=0"], ids=["fd", "classic"])
def test_two_virtual_time_sessions_write_the_same_records(uri: str, tmp_path: Path) -> None:
    """Every value, every measured lateness and round trip, every time stamp.

    Only nonces and echoes, 8 bytes of each frame, are drawn anew for every session, and with them its checksum.
    """
    records = []
    for name in ("one", "two"):
        log = tmp_path / f"{name}.mcap"
        run = [
            sys.executable,
            "-m",
            "hil",
            "run",
            "dc-motor-hinf",
            "--clock",
            "real",
            "--link",
            uri,
            "--duration",
            "10",
        ]
        done = subprocess.run(
            [
                *RUNNER,
                "--virtual-time",
                "--rw",
                str(tmp_path),
                "--",
                *run,
                "--require-valid-timing",
                "-o",
                str(log),
            ],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stdout + done.stderr
        records.append(read_run(log).arrays)
    first, second = records
    assert first.keys() == second.keys()
    for topic, rows in first.items():
        for name in set(rows.dtype.names) - {"data"}:
            assert rows[name].tobytes() == second[topic][name].tobytes(), (topic, name)
        if "data" in rows.dtype.names:
            assert [frame[4:8] + frame[16:] for frame in map(bytes, rows["data"])] == [
                frame[4:8] + frame[16:] for frame in map(bytes, second[topic]["data"])
            ]
