"""One log file on every machine: its certificate states what every CPU computes alike, and names what a solver made."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import hil
from design.verdict import FROM_A_SOLVER, Verdict
from hil.log.read import read_run
from tests.other_processors import together

NAMES = ("dc-motor-ours-hinf", "dc-motor-smith", "multisensor-published", "vtol-hinf", "vtol-fault")
OTHERS = {name: environment for name, environment in together().items() if "Nehalem" in name or "glibc" in name}


def logs(folder: Path, environment: dict[str, str]) -> dict[str, Path]:
    """Run the experiments for an instant, as on another machine; return their logs."""
    folder.mkdir()
    if environment:
        run = f"import hil\nfor name in {NAMES}: hil.run(name, duration='0.5 s', log=f'{{name}}.mcap')"
        subprocess.run([sys.executable, "-P", "-c", run], cwd=folder, env={**os.environ, **environment}, check=True)
    else:
        for name in NAMES:
            hil.run(name, duration="0.5 s", log=folder / f"{name}.mcap")
    return {name: folder / f"{name}.mcap" for name in NAMES}


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return logs(tmp_path_factory.mktemp("here") / "logs", {})


@pytest.mark.skipif(not OTHERS, reason="nothing stands for another CPU here")
@pytest.mark.parametrize("machine", OTHERS)
def test_a_log_file_has_one_sha256_but_for_what_a_solver_made(machine: str, here: dict[str, Path], tmp_path: Path) -> None:
    for name, path in logs(tmp_path / "there", OTHERS[machine]).items():
        one, other = read_run(here[name]).certificate, read_run(path).certificate
        by_solver = [key for key in FROM_A_SOLVER if f"{key}," in one["precision"] or f"{key}:" in one["precision"]]
        assert bool(by_solver) == (name == "vtol-fault")
        differ = {key for key in one if one[key] != other[key]} - set(by_solver)
        assert not differ, (name, {key: (one[key], other[key]) for key in differ})
        if not by_solver:
            assert hashlib.sha256(path.read_bytes()).digest() == hashlib.sha256(here[name].read_bytes()).digest(), name


def test_a_certificate_keeps_ten_digits_of_small_numbers_and_ten_decimals_of_residuals() -> None:
    verdict = Verdict(
        kind="guaranteed cost", state="certified", reason="", number=1.23456789012345e-14, limit=None,
        details={"residual": 4.7e-14, "norms": [1.0 / 3.0, None, float("inf")], "margin": 1.0 / 3.0, "modes": 3},
    )  # fmt: skip
    said = verdict.on_every_machine()
    assert (said["number"], said["residual"], said["modes"]) == (1.234567890e-14, 0.0, 3)
    assert said["norms"] == [0.3333333333, None, float("inf")] and said["margin"] == 0.3333333333
    found = Verdict(kind="guaranteed cost", state="certified", reason="", details={"solver": "clarabel", "margin": 1.0 / 3.0})
    assert found.on_every_machine()["margin"] == 1.0 / 3.0 and "margin: to some per cent" in str(found.on_every_machine())
    assert json.loads(json.dumps(verdict.to_json()))["residual"] == 4.7e-14
