"""A command of a forked process is that of a fresh one: outputs, status, folder, environment, and its end after a limit."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.warm_hil import hil_command

OWN = """
import os, sys, time
from plants import DCMotor
print(os.getcwd() == {folder!r}, os.environ.get("MINE"), "OTHERS" in os.environ, file=sys.stderr)
if os.environ.get("MINE") == "waits": time.sleep(600)
class Mine(DCMotor): pass
"""
WORDS = ("run", "dc-motor-hinf", "--duration", "0.2", "--set", "plant={kind='mine:Mine'}", "-o", "a.mcap", "--force")


@pytest.mark.parametrize("words", [(*WORDS, "--json"), (*WORDS, "--set", "plant.gian=3"), ("nothing",)])
def test_it_says_and_ends_as_a_fresh_one_does(words: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "mine.py").write_text(OWN.format(folder=str(tmp_path)))
    monkeypatch.setenv("OTHERS", "1")
    env = {**{name: value for name, value in os.environ.items() if name != "OTHERS"}, "MINE": "here"}
    forked = hil_command(*words, cwd=tmp_path, env=env)
    fresh = subprocess.run([sys.executable, "-m", "hil", *words], cwd=tmp_path, env=env, capture_output=True, text=True)
    assert (forked.returncode, forked.stderr) == (fresh.returncode, fresh.stderr)
    without_time = [[line for line in done.stdout.splitlines() if "wall_s" not in line] for done in (forked, fresh)]
    assert without_time[0] == without_time[1]


def test_what_does_not_end_is_killed_and_the_next_command_runs(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(OWN.format(folder=str(tmp_path)))
    with pytest.raises(subprocess.TimeoutExpired):
        hil_command(*WORDS, cwd=tmp_path, env={**os.environ, "MINE": "waits"}, timeout=2.0)
    assert hil_command("list", cwd=tmp_path).returncode == 0
