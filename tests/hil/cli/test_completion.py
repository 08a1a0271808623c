"""Completion: what the shell is offered, through the script that it reads."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from hil.cli.completion import SHELLS, script
from tests.hil.cli.conftest import Hil


def offered(*words: str) -> list[str]:
    """Return what is offered for the last word, as bash asks for it."""
    asked = {"_HIL_COMPLETE": "bash_complete", "COMP_WORDS": " ".join(words), "COMP_CWORD": str(len(words) - 1)}
    done = subprocess.run(
        [sys.executable, "-c", "from hil.cli import main; main([])"], env=os.environ | asked,
        capture_output=True, text=True, check=True, timeout=120,
    )  # fmt: skip
    return [line.partition(",")[2] for line in done.stdout.splitlines() if line]


def test_commands_experiments_and_keys_are_offered() -> None:
    assert {"replay", "report", "reproduce", "recover"} <= set(offered("hil", "re"))
    assert {"dc-motor-hinf", "dc-motor-h2"} <= set(offered("hil", "run", "dc-motor-h"))
    assert "plant.gain=" in offered("hil", "run", "dc-motor-hinf", "--set", "plant.")
    assert "links.sc.law.matrix=" in offered("hil", "sweep", "dc-motor-hinf", "--set", "links.sc.law")
    assert offered("hil", "run", "no-such", "--set", "plant.") == []


@pytest.mark.parametrize("shell", SHELLS)
def test_install_writes_below_the_home_only(cli: Hil, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shell: str) -> None:
    for name in ("XDG_DATA_HOME", "XDG_CONFIG_HOME"):
        monkeypatch.setenv(name, str(tmp_path / name))
    status, out, _ = cli("completion", "install", shell)
    (written,) = [p for p in tmp_path.rglob("*") if p.is_file()]
    assert status == 0 and str(written) in out and written.read_text() == script(shell)
    assert "_HIL_COMPLETE" in written.read_text()


@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
def test_bash_takes_the_script(tmp_path: Path) -> None:
    (tmp_path / "hil").write_text(f"#!/bin/sh\nexec {sys.executable} -m hil \"$@\"\n")
    (tmp_path / "hil").chmod(0o755)
    (tmp_path / "script").write_text(script("bash"))
    ask = (
        f"source {tmp_path}/script; complete -p hil; compopt() {{ :; }}\n"
        "COMP_WORDS=(hil run dc-motor-hinf --set plant.ga); COMP_CWORD=4; _hil_completion hil; echo ${COMPREPLY[@]}"
    )
    done = subprocess.run(
        ["bash", "--norc", "-c", ask], env=os.environ | {"PATH": f"{tmp_path}:{os.environ['PATH']}"},
        capture_output=True, text=True, timeout=120, check=True,
    )  # fmt: skip
    assert "_hil_completion hil" in done.stdout and done.stdout.splitlines()[-1] == "plant.gain="
