"""Too few file descriptors: a run in real time says so in one line, and leaves nothing behind."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from hil.runtime.real.supervisor import _two_pipes

RUN = """
import resource, sys
resource.setrlimit(resource.RLIMIT_NOFILE, (int(sys.argv[1]),) * 2)
from hil.cli import main
main(sys.argv[2:])
"""


@pytest.mark.parametrize(("link", "limits"), [("zenoh:?name=few", (9, 16)), ("can:hil:few", (9, 12))])
def test_a_run_without_descriptors_is_one_message_with_status_2(tmp_path: Path, link: str, limits: tuple[int, int]) -> None:
    statuses = []
    for most in limits:
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


def test_where_the_second_pipe_is_not_to_be_had_the_first_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[tuple[int, int]] = []
    real = os.pipe

    def once() -> tuple[int, int]:
        if made:
            raise OSError(24, "Too many open files")
        made.append(real())
        return made[0]

    monkeypatch.setattr(os, "pipe", once)
    with pytest.raises(OSError, match="Too many open files"):
        _two_pipes()
    for fd in made[0]:
        with pytest.raises(OSError, match="Bad file descriptor"):
            os.fstat(fd)
