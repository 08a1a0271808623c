"""The workflows of `hil guide ci` are YAML, and what they run runs as it is written there and leaves what they keep."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml  # type: ignore[import-untyped]

from tests.warm_hil import hil_command

TOP = Path(__file__).parents[2]
PROJECT = tomllib.loads((TOP / "pyproject.toml").read_text())["project"]
PAGE = (TOP / "hil/guide/ci.md").read_text(encoding="utf-8")
GITHUB, GITLAB, VCAN = map(yaml.safe_load, re.findall(r"```yaml\n(.*?)```", PAGE, flags=re.S))

TEST = """
def test_step_is_tracked(hil):
    session = hil.run("dc-motor-hinf", seed=3)
    assert session.status == 0
    assert session.metrics["sse_after_5s"] < 0.06
"""


def of_github(steps: list[dict[str, Any]]) -> list[str]:
    return [step["run"].strip() for step in steps if "run" in step]


COMMANDS = {"github": of_github(GITHUB["jobs"]["test"]["steps"]), "gitlab": GITLAB["test"]["script"], "vcan": of_github(VCAN)}


def test_each_job_installs_this_package_and_what_its_tests_take() -> None:
    known = {PROJECT["name"], *(line.partition(">")[0] for line in PROJECT["optional-dependencies"]["test"])}
    for name in ("github", "gitlab"):
        install, run, *_ = map(shlex.split, COMMANDS[name])
        assert install[:2] == ["pip", "install"] and {word for word in install[2:] if word != "--no-compile"} <= known
        assert {"hilrig", "pytest"} <= set(install) and ("pytest-xdist" in install) == ("-n" in run)


@pytest.mark.parametrize("name", ["github", "gitlab"])
def test_the_tests_run_as_written_and_leave_what_the_job_keeps(name: str, tmp_path: Path) -> None:
    (tmp_path / "test_step.py").write_text(TEST)
    command = shlex.split(COMMANDS[name][1])
    environment = {key: value for key, value in os.environ.items() if not key.startswith("PYTEST")}
    environment["PYTEST_ADDOPTS"] = "-p no:hypothesispytest"  # it imports all of hypothesis at the end of each process
    done = subprocess.run(
        [sys.executable, "-m", *command], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=240, check=False
    )
    assert done.returncode == 0 and "1 passed" in done.stdout, done.stdout + done.stderr
    kept = GITLAB["test"]["artifacts"] if name == "gitlab" else GITHUB["jobs"]["test"]["steps"][-1]["with"]
    folders = kept["paths"] if name == "gitlab" else [kept["path"]]
    assert all(list((tmp_path / folder).rglob("*.mcap")) for folder in folders)
    assert 'name="hil_verdict" value="certified"' in (tmp_path / "junit.xml").read_text()
    report = COMMANDS["github"][2] if name == "github" else GITLAB["test"]["after_script"][0]
    assert hil_command(*shlex.split(report)[1:], cwd=tmp_path).returncode == 0
    assert "test_step_is_tracked/dc-motor-hinf-0.mcap" in (tmp_path / folders[0] / "index.html").read_text()
    if name == "gitlab":
        assert (tmp_path / kept["reports"]["junit"]).is_file()


def test_the_step_with_a_vcan_has_options_that_exist(tmp_path: Path) -> None:
    (command,) = COMMANDS["vcan"]
    ours, theirs = command.split(" -- ")
    for said in (ours, theirs):
        program, *words = [*shlex.split(said), "--help"]
        done = hil_command(*words, cwd=tmp_path, program=program)
        assert done.returncode == 0, done.stderr  # an unknown option before --help is an error
        options = [word.partition("=")[0] for word in words if word.startswith("--")]
        assert all(option in done.stdout for option in options)


def test_the_cache_of_the_kernel_has_the_version_of_this_package_in_its_key() -> None:
    keys = [step["with"]["key"] for step in VCAN if "cache" in step.get("uses", "")]
    assert len(keys) == 1 and PROJECT["version"] in keys[0]
