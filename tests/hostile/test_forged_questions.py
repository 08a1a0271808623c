"""Who asks the controller in the rig's place: nothing of it moves the plant unseen; with a key the log is verified, too."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from hil.files.keys import make_keys
from hil.session.replay.replay import verify
from tests.hostile.test_who_commands import session
from tests.warm_hil import hil_command

pytestmark = pytest.mark.realtime


@pytest.mark.parametrize("way", ["more", "future", "hello", "same", "beside"])
def test_forged_questions_are_refused_said_and_leave_every_answer_as_it_was(tmp_path: Path, way: str) -> None:
    channel = f"ask{os.getpid()}-{way}"
    program = [sys.executable, str(Path(__file__).with_name("asker.py")), channel, way]
    with subprocess.Popen(program, stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout is not None and process.stdout.readline() == b"up\n"
            status, summary, run = session(tmp_path, f"can:hil:{channel}")
        finally:
            process.kill()
    counted = summary["controller_counters"]
    assert counted["refused"] + counted["contradicted"] + counted["malformed"] > 10, counted
    assert "controller_refused" in summary["problems"]
    # 5: it was faster than the rig, and the rig saw it; 3: a machine so busy that the watchdog trips
    assert status in (0, 3, 5), summary
    assert (status == 5) == ("second_controller" in summary["problems"])
    if status == 0:
        assert verify(run).difference is None  # each answer is that to the rig's own frames


def test_a_log_of_a_session_with_a_key_is_verified(tmp_path: Path) -> None:
    make_keys(tmp_path / "keys")
    status, summary, run = session(tmp_path, f"can:hil:ver{os.getpid()}?auth=keys/frames.key")
    assert status in (0, 3) and summary["link_counters"]["refused"] == 0
    assert summary["controller_counters"]["refused"] == 0 and "controller_refused" not in summary["problems"]
    verdict = verify(run)
    assert verdict.difference is None and verdict.answers > 0
    done = hil_command("replay", "run.mcap", cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    replay = ["replay", "run.mcap", "--json", "--auth"]
    done = hil_command(*replay, "keys/frames.key", cwd=tmp_path)
    tags = json.loads(done.stdout)["tags"]
    assert done.returncode == 0 and tags["verified"] >= verdict.answers and tags["wrong"] == 0, done.stdout + done.stderr
    make_keys(tmp_path / "others")
    done = hil_command(*replay, "others/frames.key", cwd=tmp_path)
    assert done.returncode == 1 and json.loads(done.stdout)["tags"] == {"verified": 0, "wrong": tags["verified"], "first": 0}
