"""Two machines, one log: sessions of two processes over vcan0 in virtual time, each in a kernel of its own."""

from __future__ import annotations

import subprocess
import sys
from hashlib import sha256
from pathlib import Path

import pytest

RUNNER = [sys.executable, "-m", "hil", "vcan"]


@pytest.mark.usefixtures("boots_kernels")
@pytest.mark.parametrize("uri", ["can:socketcan:vcan0?version=1", "can:socketcan:vcan0?version=1&fd=0"], ids=["fd", "classic"])
def test_two_virtual_time_sessions_write_the_same_log_to_the_byte(uri: str, tmp_path: Path) -> None:
    """Every value, every measured lateness and round trip, every time stamp.

    Wire version 1, as the nonces of version 2 are drawn anew for every session.
    """
    sums = set()
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
        sums.add(sha256(log.read_bytes()).hexdigest())
    assert len(sums) == 1
