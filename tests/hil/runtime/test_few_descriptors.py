"""Too few file descriptors: a run in real time says so in one line, and leaves nothing behind."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

RUN = """
import resource, sys
resource.setrlimit(resource.RLIMIT_NOFILE, (int(sys.argv[1]),) * 2)
from hil.cli import main
main(sys.argv[2:])
"""


@pytest.mark.parametrize("link", ["zenoh:?name=few", "can:hil:few"])
def test_a_run_without_descriptors_is_one_message_with_status_2(tmp_path: Path, link: str) -> None:
    statuses = []
    for most in (9, 10, 12, 14, 16):
        command = ["run", "dc-motor-hinf", "--clock", "real", "--link", link, "--duration", "0.1", "-o", "run.mcap"]
        done = subprocess.run(
            [sys.executable, "-c", RUN, str(most), *command], cwd=tmp_path, capture_output=True, text=True, timeout=120
        )
        assert done.returncode in (0, 2) and "Traceback" not in done.stderr, (most, done.stderr)
        if done.returncode:
            assert not any(tmp_path.iterdir())
            assert len(done.stderr.splitlines()) == 1 and done.stderr.startswith("hil: "), (most, done.stderr)
        (tmp_path / "run.mcap").unlink(missing_ok=True)
        statuses.append(done.returncode)
    assert 2 in statuses
