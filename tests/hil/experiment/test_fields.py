"""A fault is shown with the path of its field: the error says which field, nobody reads it off a message."""

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
        ({"tanks": [], "spare": [{"a": {"level": -1.0}}]}, "plant.spare[0][...].level: is negative"),
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
    assert fault_at("links.sc.law", copy) == "links.sc.law.sojourn[2].p: is 2, expected 0 to 1"


def test_no_package_below_hides_a_field_in_a_message() -> None:
    hidden = []
    for package in ("plants", "transport", "design"):
        for path in sorted((ROOT / package).rglob("*.py")):
            text = path.read_text(encoding="utf-8")
            for node in ast.walk(ast.parse(text)):
                if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call) and node.exc.args:
                    said = ast.get_source_segment(text, node.exc.args[0]) or ""
                    if ast.unparse(node.exc.func) == "ValueError" and FIRST_WORD.match(said):
                        hidden.append(f"{path.relative_to(ROOT)}:{node.lineno}")
    assert not hidden, "raise FieldError(field, message) of the package"
