"""What ``make check`` runs: the tests of the changed files, and of nothing else."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from tests.changed import before, changed, chosen_for


@pytest.mark.parametrize(
    ("name", "runs", "leaves"),
    [
        ("design/tracking/bfgs.py", {"tests/design/tracking"}, {"tests/design/lmi"}),
        ("hil/runtime/real/ending.py", {"tests/hil/runtime/real", "hil/runtime/real/ending.py"}, {"tests/hil/cli"}),
        ("hil/log/topics/__init__.py", {"tests/hil/log"}, {"tests/hil", "tests"}),
        ("hil/session/__init__.py", {"tests/hil/session", "tests/realtime/test_sessions.py"}, {"tests/hil", "tests/plants"}),
        ("tests/waiting.py", {"tests/hil/cli/test_run.py"}, {"tests/hil/cli"}),
        ("tests/links/conftest.py", {"tests/links"}, {"tests"}),
        ("tests/links/test_can_bus.py", {"tests/links/test_can_bus.py"}, {"tests/links"}),
        ("hil/guide/faults.md", {"tests/contract/test_readme.py"}, set()),
    ],
)
def test_a_change_runs_the_tests_of_its_room_and_of_the_rooms_that_import_it(name: str, runs: set[str], leaves: set[str]) -> None:
    found = {*chosen_for([name])}
    assert runs <= found and not leaves & found


def test_a_file_inside_a_chosen_folder_is_not_run_twice() -> None:
    assert chosen_for(["design/tracking/bfgs.py", "tests/design/tracking/test_synthesis.py"]) == ["tests/design/tracking"]


class Git:
    """git in a folder."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def __call__(self, *words: str) -> str:
        done = subprocess.run(["git", "-c", "user.name=t", "-c", "user.email=t@t", *words], cwd=self._folder, check=True,
                              capture_output=True, text=True)  # fmt: skip
        return done.stdout.strip()

    def commit(self, text: str) -> str:
        """Commit a file with this text, whatever else there is; return the commit."""
        (self._folder / "file").write_text(text)
        self("add", "-A")
        self("commit", "-m", text)
        return self("rev-parse", "HEAD")


def test_a_change_began_where_its_branch_left_main_or_on_main_before_the_last_commit(tmp_path: Path) -> None:
    origin, clone = tmp_path / "origin", tmp_path / "clone"
    origin.mkdir()
    git = Git(origin)
    git("init", "-b", "main")
    one = git.commit("1")
    assert before(origin) is None, "the first commit of all"
    two = git.commit("2")
    assert before(origin) == one, "on main"
    git("switch", "-c", "work")
    git.commit("3")
    four = git.commit("4")
    assert before(origin) == two, "on a branch"
    git("clone", "-b", "work", f"file://{origin}", str(clone))
    assert before(clone) == two, "in a clone without main"
    git("clone", "-b", "work", "--depth", "1", f"file://{origin}", f"{clone}-1")
    assert before(Path(f"{clone}-1")) is None, "in a clone that is one commit deep"
    git("clone", "-b", "work", "--depth", "2", f"file://{origin}", f"{clone}-2")
    assert before(Path(f"{clone}-2")) == git("rev-parse", f"{four}~1"), "in one of a branch alone, its last commit"


def test_what_differs_from_main_and_what_is_new_has_changed_and_what_is_gone_has_no_tests(tmp_path: Path) -> None:
    git = Git(tmp_path)
    git("init", "-b", "main")
    for name in ("same", "later", "now", "gone"):
        (tmp_path / name).write_text("1")
    git("add", "-A")
    git("commit", "-m", "1")
    git("switch", "-c", "work")
    (tmp_path / "later").write_text("2")
    git("commit", "-am", "2")
    (tmp_path / "now").write_text("2")
    (tmp_path / "new").write_text("2")
    (tmp_path / "gone").unlink()
    assert changed(tmp_path) == ["later", "new", "now"]
    assert changed(tmp_path, "HEAD") == ["new", "now"]
