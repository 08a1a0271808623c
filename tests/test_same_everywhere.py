"""One seed, one SHA-256: on this machine as it is, and under what stands for other processors.

Every shipped experiment over 5 s (2 s at 1 kHz), sweeps split three ways, jumps split at odd places, and two studies, each
compared with the one file of the tests, which ``python -m tests.records_sha256`` writes.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import hil
from hil.cli.doctor import vector_units
from hil.experiment import load_experiment, shipped
from hil.log.read import read_run
from hil.log.run import records_sha256
from tests.other_processors import stand_ins, together
from tests.records_sha256 import FILE, found

HERE = {"as it is": {}, **together(), **stand_ins()}
"""Behind this machine the oldest one, with the fewest units of every library, and one between; each stand-in alone comes last."""

WAYS = [("1", "whole"), ("2", "odd"), ("7", "sevens")]
ROOT = Path(__file__).parents[1]


@pytest.mark.parametrize("machine", [pytest.param(name, marks=[pytest.mark.slow] * (i > 2)) for i, name in enumerate(HERE)])
def test_every_machine_comes_to_the_same_bits(machine: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    parts, split = WAYS[list(HERE).index(machine) % len(WAYS)]
    if HERE[machine]:
        environment = {**os.environ, **HERE[machine], "XDG_CACHE_HOME": str(tmp_path)}
        done = subprocess.run(
            [sys.executable, "-W", "ignore", "-m", "tests.records_sha256", parts, split], cwd=ROOT, env=environment,
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        now = json.loads(done.stdout)
    else:
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
        now = found(int(parts), split)
    written = json.loads(FILE.read_text())
    assert [name for name in written if now.get(name) != written[name]] == [] and list(now) == list(written)
    assert not list(tmp_path.rglob("*.json")), "nothing was solved here"


def test_a_machine_with_avx2_has_a_stand_in_of_every_library() -> None:
    assert {name.partition(" ")[0] for name in stand_ins()} == {"numpy", "OpenBLAS", "glibc"} or "X86_V3" not in vector_units()


def test_the_file_names_every_shipped_experiment() -> None:
    assert set(shipped()) <= set(json.loads(FILE.read_text()))


@pytest.mark.parametrize("name", ["dc-motor-ours-h2", "omni-push"])
def test_a_log_holds_the_records_of_which_the_file_has_the_sha256(name: str, tmp_path: Path) -> None:
    session = hil.run(load_experiment(name, duration="5"), log=tmp_path / "a.mcap")
    written = json.loads(FILE.read_text())[name]
    assert records_sha256(read_run(tmp_path / "a.mcap")) == records_sha256(session.run) == written
    assert session.summary["gains"] == {"origin": "stored"}
