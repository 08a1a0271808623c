"""Where a log comes from: the commit of the checkout, the same for every run of it."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

import hil
from hil.log.write import pipe_sink
from hil.log.write.provenance import Provenance, commit, loop_form


def git(folder: Path, *words: str) -> str:
    identity = ["-c", "user.name=a", "-c", "user.email=a@b"]
    done = subprocess.run(["git", "-C", str(folder), *identity, *words], capture_output=True, text=True, check=True)
    return done.stdout.strip()


def test_a_checkout_is_named_by_its_commit_and_by_what_differs_from_it(tmp_path: Path) -> None:
    assert commit(tmp_path) == "", "no checkout"
    git(tmp_path, "init", "-q")
    (tmp_path / "a").write_text("1")
    git(tmp_path, "add", "a")
    git(tmp_path, "commit", "-qm", "one")
    commit.cache_clear()
    clean = commit(tmp_path)
    assert len(clean) == 12 and git(tmp_path, "rev-parse", "HEAD").startswith(clean)
    (tmp_path / "a").write_text("2")
    commit.cache_clear()
    assert commit(tmp_path) == f"{clean}-dirty"
    commit.cache_clear()


def test_without_a_commit_there_is_no_key() -> None:
    about = Provenance(experiment="x", experiment_text="", resolved={}, seed=0, clock="virtual", link="memory:", commit="")
    assert "commit" not in about.metadata()["hilrig"]


def test_a_run_logs_its_commit_and_stays_the_same_file() -> None:
    first, second = (hil.run("dc-motor-hinf", duration=1) for _ in range(2))
    assert first.run.metadata.get("commit", "") == commit()
    assert first.summary["log"]["sha256"] == second.summary["log"]["sha256"]


@pytest.mark.parametrize(("file", "form"), [("pipe_sink.py", "interpreted"), ("pipe_sink.cpython-311.so", "compiled")])
def test_a_log_says_whether_its_loop_was_compiled(file: str, form: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert hil.run("dc-motor-hinf", duration=0.1).run.metadata["loop"] == loop_form()
    monkeypatch.setattr(pipe_sink, "__file__", f"/somewhere/{file}")
    about = Provenance(experiment="x", experiment_text="", resolved={}, seed=0, clock="virtual", link="memory:")
    assert loop_form() == about.metadata()["hilrig"]["loop"] == form
