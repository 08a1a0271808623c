"""A module of the user's that takes the place of one of our packages is named, with what helps."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest


def python(folder: Path, *args: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, *args], cwd=folder, capture_output=True, text=True, timeout=120, check=False)


@pytest.fixture(params=["design/__init__.py", "plants.py", "transport/__init__.py"])
def shadowing(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    path = tmp_path / request.param
    path.parent.mkdir(exist_ok=True)
    path.write_text("")
    return path


def test_the_command_line_names_the_file_and_the_remedy(shadowing: Path) -> None:
    folder = shadowing.parent if shadowing.name == "plants.py" else shadowing.parent.parent
    done = python(folder, "-m", "hil", "run", "dc-motor-hinf")
    assert done.returncode == 2 and f"{shadowing} shadows" in done.stderr and "rename it" in done.stderr
    assert not list(folder.rglob("*.mcap"))


def test_doctor_says_it_too(shadowing: Path) -> None:
    folder = shadowing.parent if shadowing.name == "plants.py" else shadowing.parent.parent
    found = {c["what"]: c for c in json.loads(python(folder, "-m", "hil", "doctor", "--json").stdout)}["package ownership"]
    assert not found["ok"] and str(shadowing) in found["finding"] and "rename it" in found["remedy"]


def test_the_face_and_the_fixture_say_it(shadowing: Path) -> None:
    folder = shadowing.parent if shadowing.name == "plants.py" else shadowing.parent.parent
    done = python(folder, "-c", "import hil; hil.run('dc-motor-hinf')")
    assert "hil.errors.HilError" in done.stderr and str(shadowing) in done.stderr
    (folder / "test_mine.py").write_text("def test_rig(hil): hil.run('dc-motor-hinf')\ndef test_other(): pass\n")
    done = python(folder, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:hypothesispytest", "test_mine.py")
    assert "1 failed, 1 passed" in done.stdout and str(shadowing) in done.stdout and "--import-mode=importlib" in done.stdout


def test_a_folder_without_code_shadows_nothing(tmp_path: Path) -> None:
    (tmp_path / "design").mkdir()
    assert python(tmp_path, "-c", "import hil; print(hil.run)").returncode == 0
