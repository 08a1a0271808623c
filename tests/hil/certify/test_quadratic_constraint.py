"""A stochastic integral quadratic constraint (4.6) from an experiment: gains that meet it, and what the certificate says."""

from __future__ import annotations

from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from design.requests.scheduled import QuadraticConstraint, Scheduled
from hil.compose import compose
from hil.errors import ExperimentError
from hil.experiment import load_experiment, shipped
from hil.thesis import chapter4
from hil.thesis.chapter4 import CONSTRAINTS, constraints
from hil.thesis.statements import judge
from tests.hil.thesis.judging import assert_every_number_decides

MET = "{g11=[[1.0]], g12=[[0.01, 0.0]], g22=[[-0.001, 0.0], [0.0, -0.001]]}"


@cache
def loop(*sets: str, name: str = "vtol-fault") -> Any:
    return compose(load_experiment(name, sets))


def test_a_constraint_of_an_experiment_is_designed_for_and_stands_in_the_certificate() -> None:
    found = loop(f"controller.constraint={MET}")
    assert found.verdict.certified and found.verdict.reason.endswith("the constraint (4.6) holds")
    assert found.verdict.details["constraint"]["state"] == "certified"
    assert isinstance(found.controller, Scheduled) and found.controller.constraint is not None
    asked, plain = (np.array(each.controller.gain) for each in (found, loop()))
    assert np.abs(asked - plain).max() > 0.05 * np.abs(plain).max()  # 10 %; solved anew without the constraint, up to 1 %
    assert "constraint" not in loop().verdict.details


def test_gains_that_miss_a_constraint_are_said_to_miss_it() -> None:
    stored = loop().controller
    asked = "{g11=[[1.0]], g12=[[0.0, 0.0]], g22=[[-1.6e-5, 0.0], [0.0, -1.6e-5]]}"  # gamma 0.004, and they have 0.006
    said = f"controller={{kind='scheduled', gain={[list(map(list, m)) for m in np.array(stored.gain).tolist()]}, "
    said += f"starts_s={np.array(stored.starts_s).tolist()}, constraint={asked}}}"
    found = loop(said).verdict
    assert found.certified and found.reason.endswith("the constraint (4.6) has no proof of this form")
    assert found.details["constraint"]["state"] == "refused"


@pytest.mark.parametrize(
    ("constraint", "message"),
    [
        ("{g11=[[1.0]], g12=[[0.1]], g22=[[-1.0]]}", r"constraint\.g12: shape \(1, 1\), expected \(1, 2\): outputs y"),
        ("{g11=[[-1.0]], g12=[[0.1]], g22=[[-1.0]]}", r"constraint\.g11: eigenvalue -1, expected a positive definite"),
        ("{g11=[[1.0]], g12=[[0.1, 0.0], [1.0]], g22=[[-1.0]]}", r"controller\.constraint\.g12: expected rows of equal lengths"),
        ("{g11=[[1.0]]}", r"controller\.constraint\.g12: missing"),
    ],
)
def test_a_constraint_that_cannot_be_names_its_table(constraint: str, message: str) -> None:
    with pytest.raises(ExperimentError, match=message):
        loop(f"controller.constraint={constraint}")


def test_a_plant_without_detection_takes_no_constraint() -> None:
    with pytest.raises(ExperimentError, match="constraint: the method 'robust' takes none"):
        loop(f"controller.constraint={MET}", name="smjls-robust")
    with pytest.raises(ExperimentError, match="constraint: is for a plant that shows the detected mode"):
        loop(f"controller.constraint={MET}", "controller.method='by-plant'", name="smjls-robust")


def test_gains_for_a_constraint_are_stored_and_read(tmp_path: Path) -> None:
    from click.testing import CliRunner

    from hil.cli.list import solve as command

    path = tmp_path / "own.toml"
    text = shipped()["vtol-fault"].read_text().replace('name = "vtol-fault"', 'name = "own"')
    path.write_text(text.replace("gain_bound = 2.0", f"gain_bound = 2.0\nconstraint = {MET}"))
    assert CliRunner().invoke(command, [str(path)], catch_exceptions=False).exit_code == 0
    found = loop(name=str(path))
    assert found.gains.origin == "stored" and found.verdict.details["constraint"]["state"] == "certified"
    assert isinstance(found.controller.constraint, QuadraticConstraint)


def test_the_rows_on_constraints_hold_and_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of gains by one alternation, whose level is as good a one to hold a constraint against."""
    monkeypatch.setattr(chapter4, "fault_tolerant_feedback", partial(chapter4.fault_tolerant_feedback, rounds=1))
    rows = judge(CONSTRAINTS, constraints(lambda text, done=0, total=0, /: None))
    assert [row.verdict for row in rows] == ["reproduced", "reproduced"]
    assert_every_number_decides(rows)
