"""What a certificate rests on is compared in the run itself: who breaks its word behind the door loses the certificate."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hil
from hil.api.experiment_source import load_experiment
from hil.certify.watched import one_step
from hil.compose.loop import Loop, compose
from hil.log.read.run import read_run
from hil.pages.run.run_page import verdicts
from hil.pytest_plugin import explained
from hil.runtime.nodes.plant_watch import left_over
from hil.session import Session, run_session, simulated_session
from hil.sweeps.seeds import run_seeds
from tests.hil.compose.lying_plugins import HONEST, Plant, Table
from tests.hil.late_lies import LATE, WHEN, LateTable


def loop_of(plant: object, table: object, **changes: Any) -> Loop:
    told = {"plant": plant, "controller": table, "duration": "20 s", "limits.state": {}} | changes
    found = compose(load_experiment("dc-motor-h2", allow_uncertified=True, **told))
    assert found.verdict is not None and found.verdict.certified, found.verdict
    return found


def said(session: Session) -> str:
    told = session.summary["problems"].get("certificate_withdrawn", "")
    claim = session.summary["certificate"]
    assert (claim["state"], claim["reason"]) == ("undecided", told) if told else claim["state"] == "certified"
    assert session.status == (7 if told else 0)
    return str(told)


@pytest.mark.parametrize("lie", LATE)
def test_a_plant_that_lies_late_loses_its_certificate(lie: str) -> None:
    told = said(simulated_session(loop_of(Plant(lie), Table()), 3))
    assert told.startswith("certificate withdrawn: the plant left its model at slot 3"), told


@pytest.mark.parametrize("late", WHEN)
def test_a_controller_that_lies_late_loses_its_certificate(late: str) -> None:
    told = said(simulated_session(loop_of(Plant(), LateTable(late=late)), 3))
    assert told.startswith("certificate withdrawn: the controller left its table at slot "), told
    assert 285 < int(told.split(" slot ")[1].split()[0]) < 305


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("lie", ["none", *HONEST])
def test_noise_and_loads_are_no_lie(lie: str, seed: int) -> None:
    assert not said(simulated_session(loop_of(Plant(lie), Table()), seed))


def test_a_disturbance_of_the_input_is_part_of_the_model() -> None:
    pulse = [{"at": "11 s", "samples": 20, "value": [0.3]}]
    assert not said(simulated_session(loop_of(Plant("noise"), Table(), disturbance=pulse), 1))


def test_log_page_and_json_say_that_the_certificate_is_withdrawn(tmp_path: Path) -> None:
    loop = loop_of(Plant("unstable after slot 300"), Table())
    session = run_session(loop.experiment, path=tmp_path / "late.mcap")
    told = said(session)
    run = read_run(tmp_path / "late.mcap")
    event = next(event for event in run.events if event["kind"] == "certificate withdrawn")
    assert event["message"] == told and event["tick"] == int(told.split(" slot ")[1].split()[0]) and event["severity"] == "error"
    assert run.certificate["state"] == "certified"  # what was claimed before stands in the log
    assert told in json.dumps(session.summary)
    badge = next(badge for badge in verdicts(run, session.summary) if badge.detail == told)
    assert badge.label == "undecided: mean-square stability" and badge.state == "warning"
    assert explained(session).count(told) == 1 and "status 7" in explained(session) and "verdict: undecided" in explained(session)


def test_the_same_seed_says_the_same() -> None:
    loop = loop_of(Plant("noise, and unstable after slot 300"), Table())
    assert said(simulated_session(loop, 5)) == said(simulated_session(loop, 5))


def test_the_run_is_the_same_whether_it_is_compared_or_not() -> None:
    loop = loop_of(Plant("noise"), LateTable(late="once it was asked 290 times"))
    assert loop.watched is not None
    assert str(run_seeds(loop, [4])) == str(run_seeds(replace(loop, watched=None), [4]))  # a number may be nan


def test_the_record_of_a_plant_without_its_states_is_compared_by_its_outputs() -> None:
    rng = np.random.default_rng(8)
    hidden = loop_of(Plant(), Table()).model

    class Closed(Plant):
        states = ()

    step = one_step(Closed(), hidden)  # type: ignore[arg-type]
    assert step is not None and step.taps.shape == (3, 1, 2)
    x, rows = rng.standard_normal(2), []
    for _ in range(40):
        u = rng.standard_normal(1)
        rows.append([*(hidden.C @ x), *u])
        x = hidden.A @ x + hidden.B @ u
    left, scale = left_over(step.taps, np.array(rows))
    assert np.abs(left).max() < 1e-12 * scale.max()
    rows[30][0] += 1e-3
    left, scale = left_over(step.taps, np.array(rows))
    assert np.abs(left[:28]).max() < 1e-12 < 1e-4 < np.abs(left[28:31]).min(axis=0).max()


def test_a_sweep_says_it_of_its_first_run() -> None:
    experiment = loop_of(Plant("unstable after slot 300"), Table()).experiment
    found = hil.sweep(experiment, runs=2, jobs=1)
    assert found.caution.startswith("certificate withdrawn: the plant left its model at slot 30")
