"""What CI runs is there: a script that a change moved away would fail the whole of CI, and no other test."""

from __future__ import annotations

import os
import re
import runpy
import subprocess
from pathlib import Path

import pytest

TOP = Path(__file__).parents[2]


@pytest.mark.parametrize("script", [".ci/run", ".ci/smoke", ".ci/apt_install", "tests/with_vcan"])
def test_a_script_is_executable_and_the_shell_reads_it(script: str) -> None:
    assert os.access(TOP / script, os.X_OK)
    subprocess.run(["sh", "-n", str(TOP / script)], check=True)


def test_ci_calls_scripts_and_targets_that_exist() -> None:
    text = (TOP / ".ci/run").read_text()
    called = re.findall(r"^([\w.]+/\S+)", text, flags=re.M)
    assert called and all(os.access(TOP / path, os.X_OK) for path in called), called
    targets = [word for line in re.findall(r"^make (.*)", text, flags=re.M) for word in line.split() if re.match(r"[a-z]", word)]
    makefile = (TOP / "Makefile").read_text()
    assert targets == ["test", "test-vcan", "wheel", "mutations"]
    assert all(re.search(rf"^{name}:", makefile, flags=re.M) for name in targets)


def test_ci_runs_the_tests_in_an_order_of_its_own_and_says_which() -> None:
    text = (TOP / ".ci/run").read_text()
    assert re.search(r"^seed=\$\(git log -1 --format=%ct .*\)$", text, flags=re.M)
    assert re.search(r"^make test .*--random-order-seed=\$seed", text, flags=re.M)
    assert re.search(r"^echo .*--random-order-seed=\$seed", text, flags=re.M)


def test_the_guide_has_a_row_for_each_user_of_the_script_and_what_he_types() -> None:
    users = runpy.run_path(str(TOP / ".ci/first_success"))["USERS"]
    page = (TOP / "hil/guide/quick-start.md").read_text()
    rows = dict(re.findall(r"^\| (\S+) \| (.*?) \| \d+ s \|", page, flags=re.M))
    assert list(rows) == list(users) and len(users) == 7
    for name, (_, typed) in users.items():
        commands = re.findall(r"hil (?:run|report|new \w+|rig|design|stiffness-map)", " ".join(typed))
        assert all(command in rows[name] for command in commands), name
