"""Gains come from the file that the solver wrote, while it fits its problem; what is solved instead is said.

What decides them is every number of a request and of its loop, and nothing that a text leaves out.
"""

from __future__ import annotations

import json
import shutil
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from design.controllers import LoopModel, SendAll, Turns
from design.processes.further_rates import UserRate
from design.processes.rates import clip_rate
from design.processes.semi_markov import SemiMarkov
from design.requests.tracking import Designed, DesignTask
from hil.compose import compose, solved_gains
from hil.compose.stored_gains import FORMAT, NoDigest, _said, problem_digest
from hil.experiment import Experiment, load_experiment, shipped
from hil.rig.loop import Gains
from tests.hil.cli.conftest import Hil, run_main
from tests.hil.cli.conftest import cli as cli


@dataclass(frozen=True)
class Part:
    number: float = 0.0
    text: str = ""
    rows: tuple[float, ...] = ()
    table: dict[str, Any] = field(default_factory=dict)
    nothing: None = None
    derived: int = field(default=7, init=False)


def test_a_problem_is_said_by_what_it_states_and_nothing_else() -> None:
    assert _said(Part()) == {"class": "Part", "number": 0.0}
    part = Part(rows=(1.0, 2.0), table={"a": np.array([[True]]), "b": np.int64(3)})
    assert _said({1: part, "turns": Turns(order=(0, 1), loss=0.5)}) == {
        "1": {"class": "Part", "number": 0.0, "rows": [1.0, 2.0], "table": {"a": [[True]], "b": 3}},
        "turns": {"class": "Turns", "order": [0, 1], "phase": 0, "loss": 0.5},
    }
    with pytest.raises(NoDigest, match="the problem holds a function"):
        _said([Part(table={"law": test_a_problem_is_said_by_what_it_states_and_nothing_else})])
    with pytest.raises(NoDigest, match="the problem holds a type"):
        _said(Part)


def test_every_number_of_request_and_loop_decides_the_digest_and_no_folder_does() -> None:
    one = np.eye(1)
    model = LoopModel(A=one, B=one, C=one, period_s=0.1, tau_max=1, d_max=0)
    task = DesignTask(model=model, folder="here")
    same = problem_digest(Designed(), task)
    assert same == problem_digest(Designed(), DesignTask(model=model, folder="there", chainless="why"))
    others = [
        problem_digest(Designed(design_seed=1), task), problem_digest(Designed(input_weight=np.nextafter(0.01, 1.0)), task),
        problem_digest(Designed(), DesignTask(model=LoopModel(A=2 * one, B=one, C=one, period_s=0.1, tau_max=1, d_max=0))),
        problem_digest(Designed(), DesignTask(model=model, initial_state=np.zeros(1))),
    ]  # fmt: skip
    assert len({same, *others}) == 5


NAME = "dc-motor-ours-h2"


@pytest.fixture
def own(tmp_path: Path) -> Path:
    """An experiment of a user's own that asks for a design."""
    path = tmp_path / "own.toml"
    path.write_text(shipped()[NAME].read_text().replace(f'name = "{NAME}"', 'name = "own"'))
    return path


def gains_of(experiment: Experiment) -> Gains:
    found = compose(experiment, certify=False).gains
    assert found is not None
    return found


def test_one_command_stores_the_gains_beside_the_experiment(cli: Hil, own: Path) -> None:
    first = compose(load_experiment(own), certify=False)
    assert first.gains is not None and first.gains.origin == "solved here"
    assert "gains/own.json is not there; `hil solve` stores them" in first.gains.note
    status, out, _ = cli("solve", own)
    assert status == 0 and "gains of own (send-all)" in out
    said = json.loads((own.parent / "gains" / "own.json").read_text())
    assert said["format"] == FORMAT and len(said["problem"]) == 64
    loop = compose(load_experiment(own))
    assert loop.gains == Gains(origin="stored") and loop.controller == first.controller
    assert loop.verdict is not None and loop.verdict.certified, "computed from the gains that run"


def test_gains_that_are_stored_run_and_not_what_would_be_solved(cli: Hil, own: Path) -> None:
    cli("solve", own)
    path = own.parent / "gains" / "own.json"
    said = json.loads(path.read_text())
    said["controller"]["gains"][0][0][0][0] *= 0.5
    path.write_text(json.dumps(said))
    loop, solved = compose(load_experiment(own)), compose(load_experiment(NAME))
    assert loop.gains == Gains(origin="stored") and isinstance(loop.controller, SendAll)
    assert loop.controller.gains[0][0][0][0] == said["controller"]["gains"][0][0][0][0]
    assert loop.verdict is not None and solved.verdict is not None
    assert loop.verdict.number != solved.verdict.number, "the certificate is of the gains that run"


@pytest.mark.parametrize("change", ["plant.gain=151.0", "controller.input_weight=0.02", 'period="49 ms"'])
def test_a_file_of_another_problem_is_not_used_and_that_is_said(change: str) -> None:
    stored, changed = load_experiment(NAME), load_experiment(NAME, [change])
    assert gains_of(stored).origin == "stored"
    loop = compose(changed, certify=False)
    assert loop.gains is not None and loop.gains.origin == "solved here"
    assert f"gains/{NAME}.json is of another problem" in loop.gains.note
    assert loop.controller != compose(stored, certify=False).controller


@pytest.mark.parametrize("change", ["seed=3", 'duration="2 s"', 'reference=[{at="2 s", value=[1.0]}]'])
def test_what_is_no_part_of_the_problem_changes_nothing(change: str) -> None:
    assert gains_of(load_experiment(NAME, [change])).origin == "stored"


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("{", "cannot be used"),
        ("[]", "is no file of gains"),
        ('{"format": "hilrig-gains/1", "controller": {}}', "is of another problem"),
        ('{"format": "hilrig-gains/1", "kind": "theirs:Theirs", "controller": {}}', "names a module, 'theirs:Theirs', which the"),
    ],
)
def test_a_damaged_file_is_reported_and_solved_again(own: Path, text: str, why: str) -> None:
    (own.parent / "gains").mkdir()
    (own.parent / "gains" / "own.json").write_text(text)
    found = gains_of(load_experiment(own))
    assert found.origin == "solved here" and why in found.note


@pytest.fixture(scope="module")
def mine(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `hil design -o` wrote."""
    path = tmp_path_factory.mktemp("design") / "mine.json"
    assert run_main("design", NAME, "--objective", "h2", "--starts", "1", "-o", str(path)) == 0
    return path


@pytest.fixture
def filed(mine: Path, own: Path) -> Path:
    """An experiment of a user's own that names a file of gains."""
    shutil.copy(mine, own.parent)
    own.write_text(own.read_text().replace('kind = "designed"', 'kind = "designed"\nfile = "mine.json"'))
    return own


def test_gains_of_a_named_file_run_while_they_are_for_the_loop(filed: Path) -> None:
    loop, said = compose(load_experiment(filed)), json.loads((filed.parent / "mine.json").read_text())
    assert loop.gains == Gains(origin="stored") and isinstance(loop.controller, SendAll)
    assert np.array_equal(np.array(loop.controller.gains), said["gains"])
    for name in ("dc-motor-ours-bursty", "vtol-ours-hinf"):
        assert compose(load_experiment(name), certify=False).gains == Gains(origin="stored")


@pytest.mark.parametrize(
    ("change", "part"),
    [
        ("plant.gain=151.0", "B of the plant differs by "),
        ("network.ca.law.matrix=[[0.4, 0.6], [0.7, 0.3]]", "the chain of network.ca differs by 0.1"),
        ('network.ca.law={kind="constant", age=0}', "the chain of network.ca: shape (2, 2), and not (1, 1)"),
    ],
)
def test_a_named_file_of_another_problem_is_solved_again_and_that_is_said(
    cli: Hil, filed: Path, tmp_path: Path, change: str, part: str
) -> None:
    """What the file asks for, here its objective, is asked again; the gains fit the loop, and its certificate is of them."""
    status, out, err = cli("run", filed, "--set", change, "--duration", "1", "-o", tmp_path / "a.mcap", "--json")
    gains = json.loads(out)["gains"]
    assert status == 0 and gains["origin"] == "solved here", err
    assert gains["note"].startswith(f"mine.json is of another problem ({part}") and "hil design -o" in gains["note"]
    asked_anew = compose(load_experiment(filed, [change, 'controller={kind="designed"}']), certify=False).controller
    loop = compose(load_experiment(filed, [change]))
    assert loop.verdict is not None and loop.verdict.certified and isinstance(loop.controller, SendAll)
    assert isinstance(asked_anew, SendAll)
    assert np.allclose(np.array(loop.controller.gains), np.array(asked_anew.gains), atol=1e-4)


def test_a_named_file_says_what_it_asks_for_and_the_table_does_not(filed: Path) -> None:
    path = filed.parent / "mine.json"
    said = json.loads(path.read_text())
    said["problem"] |= {"gain_bound": 0.05}
    path.write_text(json.dumps(said))
    found = compose(load_experiment(filed, ["plant.gain=151.0"])).controller
    assert isinstance(found, SendAll) and np.abs(np.array(found.gains)).max() <= 0.05 + 1e-12


@pytest.mark.parametrize("key", ["problem", "A", "sc", "objective"])
def test_a_named_file_without_its_problem_is_refused(cli: Hil, filed: Path, tmp_path: Path, key: str) -> None:
    path = filed.parent / "mine.json"
    said = json.loads(path.read_text())
    (said if key == "problem" else said["problem"]).pop(key)
    if key == "objective":
        said["problem"]["objective"] = "h3"
    path.write_text(json.dumps(said))
    status, _, err = cli("run", filed, "-o", tmp_path / "a.mcap")
    assert status == 2 and "controller.file: problem: " in err and not (tmp_path / "a.mcap").exists()


def test_the_summary_and_the_terminal_say_where_gains_come_from(cli: Hil, own: Path, tmp_path: Path) -> None:
    status, out, _ = cli("run", NAME, "--duration", "1", "-o", tmp_path / "a.mcap", "--json")
    assert status == 0 and json.loads(out)["gains"] == {"origin": "stored"}
    status, out, _ = cli("run", own, "--duration", "1", "-o", tmp_path / "b.mcap")
    assert status == 0 and "solved here" in out
    status, out, _ = cli("run", "dc-motor-hinf", "--duration", "1", "-o", tmp_path / "c.mcap", "--json")
    assert status == 0 and json.loads(out)["gains"] is None


def test_given_gains_are_not_solved(cli: Hil) -> None:
    status, _, err = cli("solve", "dc-motor-hinf")
    assert status == 2 and "its gains are given" in err
    assert solved_gains(load_experiment("vtol-ours-hinf")) is None, "a file of the user's has them"


def test_a_problem_with_a_function_in_it_has_no_digest() -> None:
    rate = UserRate(function=lambda h: 1.0 + 0.0 * h, lower=1.0, upper=1.0, horizon_s=1.0)
    experiment = load_experiment("smjls-robust")
    process = SemiMarkov(rates=((None, rate), (clip_rate(0.1, 1.0), None)))
    task = DesignTask(model=compose(experiment, certify=False).model, jump_process=process)
    with pytest.raises(NoDigest, match="function"):
        problem_digest(experiment.controller, task)  # type: ignore[arg-type]


def test_a_file_in_the_place_of_the_folder_of_gains_is_one_message(cli: Hil, own: Path) -> None:
    (own.parent / "gains").write_text("")
    status, out, err = cli("solve", own)
    assert (status, out) == (2, "") and "gains: cannot be made: File exists" in err and "Traceback" not in err
