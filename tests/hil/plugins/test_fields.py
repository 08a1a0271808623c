"""A fault is shown with the path of its field: the error says which field, no code reads it off a message."""

from __future__ import annotations

import ast
import pickle
import re
from dataclasses import dataclass
from pathlib import Path

import pytest

import design.errors
import plants.errors
import transport.errors
from hil.errors import HilError
from hil.experiment import load_experiment
from hil.experiment.table_check import TableCheck, fault_at

ROOT = Path(__file__).parents[3]
FIRST_WORD = re.compile(r"""f?["'](?:[\w.\[\]-]|\{[^{}:"']+\})+: """)


@dataclass(frozen=True)
class Tank:
    level: float
    start: float = 0.0

    def __post_init__(self) -> None:
        if self.level < 0:
            raise plants.errors.FieldError("level", "is negative")
        if self.start > self.level:
            raise ValueError("Torricelli: more than the tank holds")


@dataclass(frozen=True)
class Tanks:
    tanks: tuple[Tank, ...]
    spare: list[dict[str, Tank]] | None = None


@pytest.mark.parametrize(
    ("raw", "fault"),
    [
        ({"tanks": [{"level": 1.0}, {"level": -1.0}]}, "plant.tanks[1].level: is negative"),
        ({"tanks": [{"level": 1.0, "start": 2.0}]}, "plant.tanks[0]: Torricelli: more than the tank holds"),
        ({"tanks": [], "spare": [{"a": {"level": -1.0}}]}, "plant.spare[0].a.level: is negative"),
    ],
)
def test_a_fault_stands_at_its_field_and_a_sentence_with_a_colon_is_no_field(raw: dict[str, object], fault: str) -> None:
    checker = TableCheck()
    assert checker.table(Tanks, raw, "plant", {}) is None
    assert checker.faults == [fault]


@pytest.mark.parametrize("package", [design, plants, transport])
def test_a_field_error_reads_as_before_and_survives_a_process(package: object) -> None:
    error = package.errors.FieldError("sojourn[2].p", "is 2, expected 0 to 1")  # type: ignore[attr-defined]
    copy = pickle.loads(pickle.dumps(error))
    assert isinstance(copy, ValueError) and str(copy) == "sojourn[2].p: is 2, expected 0 to 1"
    assert fault_at("network.sc.law", copy) == "network.sc.law.sojourn[2].p: is 2, expected 0 to 1"


def test_no_package_below_hides_a_field_in_a_message() -> None:
    hidden = []
    for package in ("plants", "transport", "design"):
        for path in sorted((ROOT / package).rglob("*.py")):
            text = path.read_text(encoding="utf-8")
            for node in ast.walk(ast.parse(text if "raise ValueError" in text else "")):
                if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call) and node.exc.args:
                    said = ast.get_source_segment(text, node.exc.args[0]) or ""
                    if ast.unparse(node.exc.func) == "ValueError" and FIRST_WORD.match(said):
                        hidden.append(f"{path.relative_to(ROOT)}:{node.lineno}")
    assert not hidden, "raise FieldError(field, message) of the package"


@dataclass(frozen=True)
class Lid:
    mass: float = 0.0


@dataclass(frozen=True)
class Vessel:
    tank: Tank | None = None
    cover: Lid | Tank | None = None
    spares: list[Tank] | None = None
    named: dict[str, Tank | None] | None = None
    pair: tuple[Lid, Tank] | None = None
    inner: Vessel | None = None
    marks: tuple[float, ...] | None = None


@pytest.mark.parametrize(
    ("raw", "fault"),
    [
        ({"tank": {"level": 1.0, "strat": 1.0}}, "plant.tank.strat: unknown field; did you mean 'start'?"),
        ({"tank": {"lvel": 1.0}}, "plant.tank.lvel: unknown field; did you mean 'level'?"),
        ({"cover": {"mas": 1.0}}, "plant.cover.mas: unknown field; did you mean 'mass'?"),
        ({"cover": {"level": 1.0, "strat": 0.0}}, "plant.cover.strat: unknown field; did you mean 'start'?"),
        ({"cover": 3}, "plant.cover: expected a table, got 3"),
        ({"spares": [{"level": 1.0}, {"level": 1.0, "stat": 1}]}, "plant.spares[1].stat: unknown field; did you mean 'start'?"),
        ({"named": {"a": {"level": 1.0, "stat": 1}}}, "plant.named.a.stat: unknown field; did you mean 'start'?"),
        ({"pair": [{"mass": 1.0}, {"level": 1.0, "x": 1}]}, "plant.pair[1].x: unknown field; there are level, start"),
        ({"pair": [{"mass": 1.0}]}, "plant.pair: expected a list of length 2, got 1"),
        ({"inner": {"inner": {"tank": {"level": 1.0, "strat": 1}}}}, "plant.inner.inner.tank.strat: unknown field; did you mean"),
    ],
)
def test_a_misspelt_key_is_refused_however_its_table_is_wrapped(raw: dict[str, object], fault: str) -> None:
    checker = TableCheck()
    assert checker.table(Vessel, raw, "plant", {}) is None
    assert checker.faults[0].startswith(fault), checker.faults


def test_what_is_spelt_well_is_filled_however_its_table_is_wrapped() -> None:
    checker = TableCheck()
    raw = {
        "tank": {"level": 2}, "cover": {"level": 1.0}, "spares": [{"level": 1.0}], "named": {"a": {"level": 1.0}},
        "pair": [{"mass": 1.0}, {"level": 3.0}], "inner": {"marks": [1, 2]},
    }  # fmt: skip
    assert checker.table(Vessel, raw, "plant", {}) == Vessel(
        tank=Tank(2.0), cover=Tank(1.0), spares=[Tank(1.0)], named={"a": Tank(1.0)}, pair=(Lid(1.0), Tank(3.0)),
        inner=Vessel(marks=(1.0, 2.0)),
    )  # fmt: skip
    assert not checker.faults


@pytest.mark.parametrize(
    ("experiment", "change", "near"),
    [
        ("omni-1khz", "plant.hand.stifness=3", "did you mean 'stiffness"),
        ("omni-1khz", "plant.hand.push.tremmor_n=3", "did you mean 'tremor_n'"),
        ("omni-1khz", "controller.wall.pattern.widht=3", "did you mean 'width"),
    ],
)
def test_a_misspelt_key_of_an_optional_table_of_ours_is_refused(experiment: str, change: str, near: str) -> None:
    with pytest.raises(HilError, match=re.escape(change.partition("=")[0]) + f": unknown field; {near}"):
        load_experiment(experiment, [change])
