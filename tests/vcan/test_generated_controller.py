"""The generated controller in C over real SocketCAN frames: what is applied is what our own controller applies, bit for bit."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from hil.cli.guide import pages
from hil.runtime.virtual import simulate
from tests.generated_controllers import asked_over, generate, runs
from tests.realtime.test_generated_controllers import EXACT, SEED, assert_same_run, loop_of
from tests.warm_hil import hil_command

pytestmark = pytest.mark.vcan


@pytest.mark.parametrize("language", ["python", "c"])
@pytest.mark.parametrize("options", ["", "?fd=0"], ids=["fd", "classic"])
def test_it_applies_the_same_inputs_over_vcan0(tmp_path: Path, language: str, options: str) -> None:
    loop = loop_of("dc-motor-hinf", *EXACT, f"links.uri=can:socketcan:vcan0{options}")
    words = generate(tmp_path, loop, language)  # type: ignore[arg-type]
    with runs([*words, "vcan0", *(["socketcan"] if language == "python" else [])]):
        assert_same_run(asked_over(loop, SEED, f"can:socketcan:vcan0{options}"), simulate(loop, SEED))


def test_the_page_on_ci_tests_a_controller_in_c_as_it_is_written(tmp_path: Path) -> None:
    page = pages()["ci"].read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", page, re.S)
    (tmp_path / "test_drive.py").write_text(code)
    (made,) = re.findall("`hil (new controller drive .*?)`", page)
    ((compiled, run),) = re.findall(r"^\$ (cc .*)\n\$ hil vcan .* -- (pytest .*)$", page, re.M)
    assert hil_command(*shlex.split(made), cwd=tmp_path).returncode == 0
    subprocess.run(shlex.split(compiled), cwd=tmp_path, check=True)
    words = [sys.executable, "-m", *shlex.split(run), "-p", "no:cacheprovider"]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0 and "2 passed" in done.stdout, done.stdout + done.stderr
    assert len(list((tmp_path / "logs").rglob("*.mcap"))) == 2 and 'name="hil_log"' in (tmp_path / "junit.xml").read_text()
