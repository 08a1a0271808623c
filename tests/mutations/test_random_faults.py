"""Random faults: what can go wrong at a place, what tests reach, and whether they see it."""

from __future__ import annotations

import ast
import dataclasses
import os
import resource
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.mutations import judge
from tests.mutations.blocks import blocks, with_probes
from tests.mutations.faults import ROOT
from tests.mutations.judge import EVERY_MODULE, Judge, UndecidedError, asked_for, own_tests
from tests.mutations.probe import FOLDER, LIMIT, SPENT
from tests.mutations.random_faults import Key, drawn, equivalent, places
from tests.mutations.reach import Reach, merged, read

CODE = '''"""µ: bytes before the place are more than letters."""
def kind(n: int = 3, *, loud: bool = True) -> str:
    """Say what n is."""
    if n < 0 and loud:
        raise ValueError(n)
    for k in range(n, 10):
        n += k
    return "even" if n % 2 == 0 else "odd"
'''


@pytest.mark.parametrize(
    ("code", "faulty"),
    [
        ("x = a < b", {"x = (a <= b)", "x = (a > b)"}),
        ("x = a is None", {"x = (a is not None)"}),
        ("x = a and b", {"x = (a or b)"}),
        ("x = a * b", {"x = (a / b)"}),
        ("x = f(3)", {"x = f((4))"}),
        ("x = 1e60", set()),
        ("x = f(a, b)", {"x = (f(b, a))"}),
        ("x = f(a, a)", set()),
        ("x = max(a, b)", set()),
        ("x = np.maximum(a, b)", set()),
        ("f(flag=True)", {"f(flag=(False))", "pass"}),
        ("x = max(x)", {"pass"}),
        ("x.y = a", {"pass"}),
        ("while a: f", {"while (not (a)): f"}),
        ("raise E", {"pass"}),
        ("def f(n: Literal[1] = a) -> 'tuple[1]': return n", {"def f(n: Literal[1] = a) -> 'tuple[1]': return None"}),
        ("@dataclass(frozen=True)\nclass A: pass", set()),
        ("if TYPE_CHECKING: import a", set()),
        ("__all__ = f(1)", set()),
        ("x = f'{a + 1}'", set()),
    ],
)
def test_what_can_go_wrong(code: str, faulty: set[str]) -> None:
    assert {place.put_into(code) for place in places("m.py", code)} == faulty


def test_a_fault_changes_its_place_alone_and_the_file_stays_a_program() -> None:
    found = places("m.py", CODE)
    assert len(found) == 17
    for place in found:
        faulty = place.put_into(CODE)
        ast.parse(faulty)
        lines = [n for n, (one, other) in enumerate(zip(CODE.splitlines(), faulty.splitlines()), start=1) if one != other]
        assert lines == [place.line]


def test_blocks_have_names_that_other_functions_do_not_move() -> None:
    names = [name for name, _ in blocks(ast.parse(CODE))]
    assert names == ["kind#0", "kind#1", "kind#2"]
    assert names == [name for name, _ in blocks(ast.parse("def before():\n    return 1\n" + CODE))][1:]
    assert {place.block for place in places("m.py", CODE)} == {"", "kind#0", "kind#1", "kind#2"}


def test_probes_write_what_each_test_reaches_and_change_nothing_else(tmp_path: Path) -> None:
    numbers: dict[str, int] = {}
    (tmp_path / "m.py").write_text(with_probes(CODE, lambda block: numbers.setdefault(block, len(numbers))))
    (tmp_path / "out").mkdir()
    for test, call in (("t.py::far (call)", "kind(11)"), ("t.py::loop (call)", "kind(8)")):
        env = {**os.environ, "PYTHONPATH": f"{tmp_path}:{ROOT}", FOLDER: str(tmp_path / "out"), "PYTEST_CURRENT_TEST": test}
        script = f"import m\nassert m.kind.__doc__\nprint(m.{call}, m.{call})"
        done = subprocess.run([sys.executable, "-c", script], env=env, capture_output=True, text=True, check=True)
        assert done.stdout == "odd odd\n"
    written = [file.read_text() for file in (tmp_path / "out").iterdir()]
    garbage = "999\nDemo\n\x00\x08AAAA3\n-1\n"
    timed = "T\nD0.25 0 1 t.py::far\nD0.25 0 1 t.py::far\nD1.0 1 1 t.py::loop\nD9.0 0 1 t.py::red\nD9.0 0 0 t.py::red\n"
    reach = read([*written, garbage, timed], [*numbers])
    assert (reach.tests, reach.seconds, reach.realtime) == (["t.py::far", "t.py::loop"], [0.5, 1.0], [False, True])
    assert reach.by_block == {"kind#0": [0, 1], "kind#2": [1]}


def test_a_probe_whose_descriptor_a_test_took_away_writes_to_its_own_file_alone(tmp_path: Path) -> None:
    script = (
        "import os\n"
        "from tests.mutations import probe\n"
        "probe.note(1)\n"
        "fd = probe._out[os.getpid()][0]\n"
        "os.close(fd)\n"
        "assert os.open('other', os.O_WRONLY | os.O_CREAT) == fd\n"
        "probe.note(2)\n"
        "probe.note(3)\n"
    )
    env = {**os.environ, "PYTHONPATH": str(ROOT), FOLDER: str(tmp_path), "PYTEST_CURRENT_TEST": "t.py::one (call)"}
    subprocess.run([sys.executable, "-c", script], env=env, cwd=tmp_path, check=True)
    (written,) = (file.read_text() for file in tmp_path.iterdir() if file.name != "other")
    assert (tmp_path / "other").read_bytes() == b""
    assert read([written, "D0.1 0 1 t.py::one\n"], ["a", "b", "c", "d"]).by_block == {"b": [0], "c": [0], "d": [0]}


def reach_of(*tests: str, by_block: dict[str, list[int]] | None = None, realtime: tuple[int, ...] = ()) -> Reach:
    return Reach(tests=[*tests], seconds=[1.0] * len(tests), realtime=[n in realtime for n in range(len(tests))],
                 by_block=by_block or {})  # fmt: skip


def test_a_file_that_is_measured_anew_replaces_what_it_reached() -> None:
    old = reach_of("a.py::one", "b.py::one", "b.py::two", by_block={"m#0": [0, 1], "m#1": [1, 2]})
    new = reach_of("b.py::two", by_block={"m#0": [0]})
    both = merged(old, new, ["b.py"])
    assert both.tests == ["a.py::one", "b.py::two"]
    assert both.by_block == {"m#0": [0, 1], "m#1": []}


def test_the_tests_of_a_fault_are_those_that_reach_it_nearest_first(monkeypatch: pytest.MonkeyPatch) -> None:
    (place,) = (each for each in places("plants/omni.py", "def f(x):\n    return x\n"))
    tests = ("tests/far.py::a", "tests/plants/other.py::b", "tests/plants/test_omni.py::c", "tests/plants/other.py::not_reached",
             "tests/plants/other.py::real", "tests/else.py::never")  # fmt: skip
    reach = reach_of(*tests, by_block={"plants/omni.py::f#0": [0, 1, 2, 4]}, realtime=(4,))
    assert asked_for(place, reach) == [tests[n] for n in (2, 1, 0, 4, 3)]
    monkeypatch.setattr(judge, "BUDGET_S", 2.0)
    assert asked_for(place, reach) == [tests[2], tests[1]]
    assert asked_for(place, reach_of(*tests)) == []


def test_the_tests_of_a_constant_are_those_named_after_its_file_and_those_that_reach_a_function_beside_it() -> None:
    constant, _ = places("hil/log/topics/__init__.py", "N = 3\ndef f(x):\n    return x\n")
    tests = ("tests/far.py::a", "tests/far.py::b", "tests/hil/log/test_other.py::c", "tests/hil/cli/test_run.py::d",
             "tests/hil/log/test_topics.py::named")  # fmt: skip
    reach = reach_of(*tests, by_block={"hil/log/topics/__init__.py::f#0": [1], "hil/log/m.py::f#0": [3]})
    assert asked_for(constant, reach) == [*(tests[n] for n in (4, 1, 2)), EVERY_MODULE]


def test_faults_are_drawn_by_seed_from_every_room(tmp_path: Path) -> None:
    files = ["hil/a/m.py", "hil/b/m.py", "plants/m.py"]
    for file, copies in zip(files, (1, 1, 20)):
        (tmp_path / file).parent.mkdir(parents=True)
        (tmp_path / file).write_text(CODE * copies)
    chosen = drawn(files, 20, 1, tmp_path)
    assert chosen == drawn(files, 20, 1, tmp_path) != drawn(files, 20, 2, tmp_path)
    count = {room: sum(place.room == room for place in chosen) for room in ("hil/a", "hil/b", "plants")}
    assert count == {"hil/a": 2, "hil/b": 2, "plants": 18}
    all_of_them = drawn(files, 5000, 1, tmp_path)
    assert len({place.key for place in all_of_them}) == len(all_of_them), "each has a key of its own, alike as they are"


@pytest.fixture(scope="module")
def one_judge(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Judge, Path]]:
    """A judge of a small copy, and its folder."""
    folder = tmp_path_factory.mktemp("judged") / "copy"
    folder.mkdir()
    (folder / "m.py").write_text(CODE)
    (folder / "tests").symlink_to(ROOT / "tests")
    (folder / "test_m.py").write_text(
        "import tempfile, pathlib\n"
        "from m import kind\n"
        "def test_odd(): assert kind(11) == 'odd'\n"
        "def test_even(): assert kind(12) == 'even'\n"
        "def test_moody(): assert kind(0, loud=False) == 'nothing'\n"
        "def test_where(tmp_path):\n"
        "    own = pathlib.Path(tempfile.gettempdir())\n"
        f"    assert own in tmp_path.parents and own.parent == pathlib.Path({str(folder.parent)!r})\n"
    )
    with Judge(folder, {"test_m.py::test_moody"}) as judges:
        yield judges, folder


def test_a_fault_is_killed_by_a_test_that_fails(one_judge: tuple[Judge, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    judges, folder = one_judge
    ours = [f"test_m.py::{name}" for name in ("test_odd", "test_even")]
    by_line = {str(place).partition("  ")[2]: place for place in places("m.py", CODE)}
    seen, unseen = by_line["n % 2  ->  (n // 2)"], by_line["raise ValueError(n)  ->  pass"]
    assert judges.killer(seen, ours) == ours[1]
    assert judges.killer(unseen, ours) is None
    assert judges.killer(unseen, ["test_m.py::test_moody", *ours]) is None, "what fails without a fault too kills none"
    assert judges.killer(seen, ["test_m.py::of_yesterday"]) is None
    assert judges.killer(seen, ["test_of_yesterday.py::test_odd"]) is None
    monkeypatch.setattr(judge, "LIMITS", {resource.RLIMIT_CPU: 2})
    stuck = dataclasses.replace(by_line["range(n, 10)  ->  (range(10, n))"], new="iter(lambda: n, None)")
    assert judges.killer(stuck, ours) == "pytest ends with -9"
    with pytest.raises(UndecidedError):
        judges.killer(stuck, ours, time.monotonic() + 0.5)
    with pytest.raises(UndecidedError):
        judges.killer(seen, ours, time.monotonic())
    monkeypatch.setattr(judge, "BUDGET_S", 0.0)
    with pytest.raises(UndecidedError):
        judges.killer(unseen, ["test_m.py"])
    assert (folder / "m.py").read_text() == CODE


def test_a_fault_that_removes_temporary_folders_finds_those_of_its_own_tests_alone(one_judge: tuple[Judge, Path]) -> None:
    judges, _ = one_judge
    assert judges.killer(places("m.py", CODE)[0], ["test_m.py::test_where"]) is None


@pytest.mark.parametrize("fault", sorted(equivalent()), ids=lambda fault: f"{fault[0]}: {fault[2]}"[:80])
def test_a_fault_that_changes_nothing_is_one_that_could_be_drawn(fault: Key) -> None:
    assert [place.key for place in places(fault[0], (ROOT / fault[0]).read_text())].count(fault) == 1


def test_without_a_map_the_tests_of_a_fault_are_the_files_of_its_room_nearest_first() -> None:
    place = next(each for each in places("design/tracking/bfgs.py", (ROOT / "design/tracking/bfgs.py").read_text()) if each.block)
    found = own_tests(place)
    assert found[0] == "tests/design/tracking/test_synthesis.py" and "tests/design/test_exports.py" in found
    assert all((ROOT / name).is_file() for name in found) and len(set(found)) == len(found)
    deep = places("hil/notebook.py", (ROOT / "hil/notebook.py").read_text())[0]
    assert {file.relative_to(ROOT).as_posix() for file in (ROOT / "tests/hil").glob("test_*.py")} <= {*own_tests(deep)}


def test_a_run_ends_when_its_time_is_spent_and_no_test_has_failed(tmp_path: Path) -> None:
    (tmp_path / "test_m.py").write_text(
        "import time\n"
        "def test_long():\n"
        "    end = time.process_time() + 0.2\n"
        "    while time.process_time() < end: pass\n"
        "def test_red(): assert False\n"
    )
    words = [sys.executable, "-m", "pytest", "-q", "-p", "tests.mutations.probe", "-p", "no:cacheprovider", "test_m.py"]
    for limit, status in (("0.01", SPENT), ("600", 1)):
        env = {**os.environ, "PYTHONPATH": str(ROOT), "PYTEST_ADDOPTS": "", LIMIT: limit}
        assert subprocess.run(words, cwd=tmp_path, env=env, capture_output=True).returncode == status
