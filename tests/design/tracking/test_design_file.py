"""Design files and the cache: what is written is what is read, and what is damaged is refused or solved again."""

import json
import os

import numpy as np
import pytest

from design.tracking.design_file import design_text, load_design, to_document
from design.tracking.gain_cache import cache_directory, solve_cached
from design.tracking.synthesis import TrackingProblem, solve
from tests.design.chapter7 import LAMBDA, MOTOR, PI


@pytest.fixture(scope="module")
def design():
    return solve(TrackingProblem(A=MOTOR[0], B=MOTOR[1], C=MOTOR[2], sc=LAMBDA, ca=PI, starts=1))


def document(design):
    return to_document(design, plant="dc-motor", period_s=0.05, wall_s=0.1, versions={"hilrig": "0"})


def test_written_design_is_read_back(design, tmp_path):
    path = tmp_path / "design.json"
    path.write_text(design_text(document(design)))
    read = load_design(path)
    assert np.array_equal(read.gains, design.gains)
    assert (read.selection, read.plant, read.period_s, read.integral, read.samples) == (
        "applied", "dc-motor", 0.05, False, 1,
    )  # fmt: skip
    assert list(tmp_path.iterdir()) == [path]
    wanted = {"plant", "period_s", "objective", "selection", "gains", "norms", "certificate", "seed", "wall_s", "versions"}
    assert wanted <= set(read.document)


@pytest.mark.parametrize(
    "change, message",
    [
        (lambda d: d.update(format="other"), "no design file"),
        (lambda d: d.update(selection="newest"), "selection: 'newest'"),
        (lambda d: d.update(gains=[[1.0], [1.0, 2.0]]), "gains: expected a regular nested list"),
        (lambda d: d.update(gains=[1.0]), r"gains: shape \(1,\)"),
        (lambda d: d["gains"][0][0][0].__setitem__(0, float("nan")), "gains: shape .* finite"),
        (lambda d: d.update(period_s=-1), "period_s: -1"),
        (lambda d: d["problem"].update(samples=3), "problem.samples: 3"),
        (lambda d: d["problem"].update(sc={"delays": [0, 1, 2]}), "problem.sc: expected delays and labels"),
        (lambda d: d["problem"]["sc"].update(labels=[0, 2, 1]), "problem.sc: expected delays and labels"),
        (lambda d: d["gains"][0][0][0].__setitem__(0, 10**400), "gains: a number exceeds"),
        (lambda d: d["gains"][0][0][0].__setitem__(0, 1e308), "gains: shape .* at most"),
        (lambda d: d.update(period_s=10**400), "period_s: 1000"),
        (lambda d: d["problem"]["sc"].update(labels=[0, 1, 10**12]), "problem.sc: expected delays and labels"),
        (lambda d: d["problem"]["sc"].update(delays=[0, 10**400]), "problem.sc: expected delays and labels"),
        (lambda d: d.update(selection=["applied"]), "selection: "),
        (lambda d: d.clear(), "no design file"),
    ],
)
def test_faulty_design_files_are_refused_with_path_and_field(design, tmp_path, change, message):
    path, content = tmp_path / "design.json", json.loads(json.dumps(document(design)))
    change(content)
    path.write_text(json.dumps(content))
    with pytest.raises(ValueError, match=rf"^design: .*design\.json: {message}"):
        load_design(path)


@pytest.mark.parametrize("content", [b"", b"\xff\xfe\x00", b"[" * 100_000, b"[1, 2]", b"null"])
def test_garbage_is_refused_as_a_design_file(tmp_path, content):
    path = tmp_path / "design.json"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"^design: "):
        load_design(path)
    with pytest.raises(ValueError, match=r"^design: .*No such file"):
        load_design(tmp_path / "absent.json")


def test_what_has_no_end_or_no_beginning_is_no_design_file(tmp_path):
    os.mkfifo(tmp_path / "pipe")  # a reader that waits for its writer would hang here
    (tmp_path / "zero").symlink_to("/dev/zero")
    for name in ("pipe", "zero"):
        with pytest.raises(ValueError, match=rf"^design: .*{name}: is no regular file"):
            load_design(tmp_path / name)
    with open(tmp_path / "large", "wb") as file:
        file.truncate(10**12)  # sparse
    with pytest.raises(ValueError, match="has more than"):
        load_design(tmp_path / "large")


def test_user_without_a_home_has_no_cache_and_gets_a_design(design, monkeypatch):
    def nowhere():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr("design.tracking.gain_cache.Path.home", nowhere)
    assert np.array_equal(solve_cached(design.problem).gains, design.gains)


def test_cached_design_is_the_solved_one_and_is_not_solved_again(design, tmp_path, monkeypatch):
    first = solve_cached(design.problem, directory=tmp_path)
    assert np.array_equal(first.gains, design.gains)

    def refuse(*_, **__):
        raise AssertionError("solved although it lies in the cache")

    monkeypatch.setattr("design.tracking.gain_cache.solve", refuse)
    again = solve_cached(design.problem, directory=tmp_path)
    assert np.array_equal(again.gains, design.gains) and again.certificate == first.certificate


@pytest.mark.parametrize(
    "damage",
    [
        lambda text: "garbage",
        lambda text: text[: len(text) // 2],
        lambda text: json.dumps({"gains": [[1.0]], "starts": [], "evaluations": 1}),
        lambda text: json.dumps(json.loads(text) | {"gains": [[[[10**400]]]]}),
        lambda text: json.dumps(json.loads(text) | {"evaluations": "1e400"}),
        lambda text: json.dumps(json.loads(text) | {"starts": [10**400]}),
        lambda text: json.dumps(json.loads(text) | {"gains": (1e308 * np.ones((3, 2, 1, 1))).tolist()}),
        lambda text: json.dumps(json.loads(text) | {"gains": (100 * np.ones((3, 2, 1, 1))).tolist()}),  # unstable
    ],
)
def test_damaged_cache_entry_is_solved_again(design, tmp_path, damage):
    solve_cached(design.problem, directory=tmp_path)
    (entry,) = tmp_path.iterdir()
    entry.write_text(damage(entry.read_text()))
    assert np.array_equal(solve_cached(design.problem, directory=tmp_path).gains, design.gains)


def test_cache_that_cannot_be_written_is_no_error(design, tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("")
    assert np.array_equal(solve_cached(design.problem, directory=blocked).gains, design.gains)


def test_cache_lies_where_the_user_keeps_caches(monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", "/somewhere")
    assert str(cache_directory()) == "/somewhere/hilrig/designs"
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")  # the standard says: ignore
    assert str(cache_directory()).endswith("/.cache/hilrig/designs")
