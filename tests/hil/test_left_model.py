"""What a certificate rests on is compared in the run itself: who breaks its word behind the door loses the certificate."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hil
from design.controllers import LoopModel, SendAll
from design.controllers.historical import Historical
from hil.api.experiment_source import load_experiment
from hil.api.pytest_plugin import explained
from hil.certify.conformance import one_step
from hil.compose import compose
from hil.log.read import read_run
from hil.pages.run_page import verdicts
from hil.rig.loop import Loop, OneStep, Watched
from hil.runtime.nodes.plant_watch import BLOCK, PlantWatch, left_over
from hil.session import Session, run_session, simulated_session
from hil.sweeps.seeds import run_seeds
from plants.omni import Omni
from tests.hil.compose.lying_plugins import HONEST, Plant, Table
from tests.hil.late_lies import LATE, WHEN, LateTable


def loop_of(plant: object, table: object, **changes: Any) -> Loop:
    given = {"plant": plant, "controller": table, "duration": "20 s", "limits.state": {}} | changes
    found = compose(load_experiment("dc-motor-h2", allow_uncertified=True, **given))
    assert found.verdict is not None and found.verdict.certified, found.verdict
    return found


def said(session: Session) -> str:
    why = session.summary["problems"].get("certificate_withdrawn", "")
    claim = session.summary["certificate"]
    assert (claim["state"], claim["reason"]) == ("undecided", why) if why else claim["state"] == "certified"
    assert session.status == (7 if why else 0)
    return str(why)


@pytest.mark.parametrize("lie", LATE)
def test_a_plant_that_departs_late_loses_its_certificate(lie: str) -> None:
    why = said(simulated_session(loop_of(Plant(lie), Table()), 3))
    assert why.startswith("certificate withdrawn: the plant left its model at slot 3"), why


@pytest.mark.parametrize("lie", ["very late", "noise, and very late"])
def test_a_plant_that_departs_after_the_second_run_loses_its_certificate(lie: str) -> None:
    """Slot 2500 of 3000: without noise every slot is compared; with noise what the model does not explain grows."""
    why = said(simulated_session(loop_of(Plant(lie), Table(), duration="150 s"), 3))
    assert why.startswith("certificate withdrawn: the plant left its model at slot ")
    if lie == "very late":
        assert why.split(" slot ")[1].split()[0] == "2501"


def test_a_noisy_plant_that_departs_late_without_growth_loses_its_certificate() -> None:
    """Its input acts by 30 % more from slot 2500 of 3000 on: as noise it is no larger than before."""
    why = said(simulated_session(loop_of(Plant("noise, and a stronger input after slot 2500"), Table(), duration="150 s"), 3))
    assert why.startswith("certificate withdrawn: the plant left its model at slot 250"), why


@pytest.mark.parametrize(("lie", "duration", "named"), [("noise", 1000, False), ("noise", 1001, True), ("none", 1001, False)])
def test_a_run_that_is_longer_than_what_is_compared_of_noise_says_so(lie: str, duration: float, named: bool) -> None:
    verdict = loop_of(Plant(lie), Table(), duration=duration).verdict
    assert verdict is not None
    assert any(each.startswith("behind the first 20000 slots in which noise") for each in verdict.assumptions) == named


@pytest.mark.parametrize("honest", ["a load, and late noise", "noise, and a late load"])
def test_noise_and_loads_that_begin_after_the_second_run_are_no_departure(honest: str) -> None:
    assert not said(simulated_session(loop_of(Plant(honest), Table(), duration="150 s"), 3))


@pytest.mark.parametrize("late", WHEN)
def test_a_controller_that_departs_late_loses_its_certificate(late: str) -> None:
    why = said(simulated_session(loop_of(Plant(), LateTable(late=late)), 3))
    assert why.startswith("certificate withdrawn: the controller left its table at slot "), why
    assert 285 < int(why.split(" slot ")[1].split()[0]) < 305


def test_a_restart_of_the_controller_is_no_lie_and_hides_none() -> None:
    restart = [{"at": 15, "kind": "controller-restart"}]
    assert not said(simulated_session(loop_of(Plant(), Table(), fault=restart), 3))
    why = said(simulated_session(loop_of(Plant(), LateTable(late="once it was asked 290 times"), fault=restart), 3))
    assert why.startswith("certificate withdrawn: the controller left its table at slot 290 by"), "the restart is in slot 300"


@dataclass(frozen=True)
class Replaced(Table):
    """Starts what it states, until it has been started so often."""

    honest: int = 0

    def start(self, model: LoopModel) -> Any:
        STARTED[0] += 1
        runs = SendAll(gains=nested(Table().table(model)), selection=self.selection).start(model)
        if STARTED[0] <= self.honest:
            return runs

        class Other:
            selection = runs.selection

            def rows(self, k: int, tau: int, y: Sequence[float], r: Sequence[float]) -> Any:
                return tuple(tuple(u + 0.3 * y[0] for u in row) for row in runs.rows(k, tau, y, r))

        return Other()


STARTED = [0]


def nested(K: np.ndarray) -> Any:
    return tuple(nested(part) for part in K) if K.ndim > 1 else tuple(map(float, K))


def test_the_controller_that_runs_is_compared_and_not_one_that_was_started_before() -> None:
    for honest in (10_000, 0):  # first so many as the door starts, then as many that are honest
        STARTED[0], honest = 0, honest or STARTED[0]
        loop = loop_of(Plant(), Replaced(honest=honest))
    assert said(simulated_session(loop, 3)).startswith("certificate withdrawn: the controller left its table at slot ")


def said_of_virtual(loop: Loop) -> str:
    """What a run says of a loop whose verdict was taken away, so that its controller can be another one than was judged."""
    return str(simulated_session(loop, 3).summary["problems"].get("certificate_withdrawn", ""))


class Forgetful(Historical):
    """Runs with the gains that it states, and asks for the newest samples alone."""

    def start(self, model: LoopModel) -> Any:
        runs = super().start(model)
        runs.memory = 0
        return runs


def test_a_controller_that_is_handed_fewer_samples_than_it_states_is_not_certified() -> None:
    shipped = load_experiment("multisensor-published")
    honest = compose(shipped).controller
    own = Forgetful(**{f.name: getattr(honest, f.name) for f in fields(honest)})  # type: ignore[arg-type]
    loop = compose(load_experiment("multisensor-published", controller=own, allow_uncertified=True))
    assert loop.verdict is not None and loop.verdict.state == "undecided"
    assert loop.verdict.reason.startswith("the controller takes every sample of the last 1 slots, what it states takes every")
    judged = compose(shipped)
    watched = Watched(plant=None, controller=judged.controller, claimed=True)
    late = replace(judged, controller=own, watched=watched, verdict=None)
    assert "left its table at slot 0 by what it is handed: it takes every sample of the last 1 slots" in said_of_virtual(late)


class Boasting(Omni):
    """A device that says from a slot on that it puts out some times the command."""

    def start(self, rng: np.random.Generator) -> Any:
        return Boast(super().start(rng))


class Boast:
    def __init__(self, run: Any) -> None:
        self.run, self.slots = run, 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self.run, name)

    def advance(self, *held: Any) -> None:
        self.slots += 1
        self.run.advance(*held)

    @property
    def applied(self) -> tuple[float, ...]:
        late, times = SAID
        return tuple((times if self.slots > late else 1.0) * u for u in self.run.applied)


SAID = [0.0, 5.0]


@pytest.mark.parametrize(("late", "times"), [(0, 5.0), (400, 5.0), (400, -1.0), (0, 1.0), (0, 1.0 + 1e-7)])
def test_what_a_device_says_that_it_puts_out_is_compared(late: int, times: float) -> None:
    SAID[:] = late, times
    plant = load_experiment("omni-push").plant
    own = Boasting(**{f.name: getattr(plant, f.name) for f in fields(plant)})  # type: ignore[arg-type]
    passivity = {"energy_j": 1e-9, "damping_n_s_per_m": 5.0}
    changes: dict[str, Any] = {"duration": "25 s", "limits.state": {}, "limits.passivity": passivity}
    loop = compose(load_experiment("omni-push", plant=own, allow_uncertified=True, **changes))
    assert loop.verdict is not None
    if not late and times == 5.0:
        assert loop.verdict.state == "refused" and "move its applied " in loop.verdict.reason, loop.verdict.reason
        return
    assert loop.verdict.certified
    why = said(simulated_session(loop, 3))
    if late:
        assert "the plant left its model at slot 401 by what it says that it puts out" in why
    else:
        assert not why


@pytest.mark.parametrize("lie", ["none", *HONEST])
def test_noise_and_loads_are_no_departure(lie: str) -> None:
    loop = loop_of(Plant(lie), Table())
    assert not [why for seed in (1, 2, 3) if (why := said(simulated_session(loop, seed)))]


def test_a_disturbance_of_the_input_is_part_of_the_model() -> None:
    pulse = [{"at": "11 s", "samples": 20, "value": [0.3]}]
    assert not said(simulated_session(loop_of(Plant("noise"), Table(), disturbance=pulse), 1))


def test_log_page_and_json_say_that_the_certificate_is_withdrawn(tmp_path: Path) -> None:
    loop = loop_of(Plant("unstable after slot 300"), Table())
    session = run_session(loop.experiment, path=tmp_path / "late.mcap")
    why = said(session)
    run = read_run(tmp_path / "late.mcap")
    event = next(event for event in run.events if event["kind"] == "certificate withdrawn")
    assert event["message"] == why and event["slot"] == int(why.split(" slot ")[1].split()[0]) and event["severity"] == "error"
    assert run.certificate["state"] == "certified"  # what was claimed before stands in the log
    assert why in json.dumps(session.summary)
    badge = next(badge for badge in verdicts(run, session.summary) if badge.detail == why)
    assert badge.label == "undecided: mean-square stability" and badge.state == "warning"
    assert explained(session).count(why) == 1 and "status 7" in explained(session) and "verdict: undecided" in explained(session)


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


def sums_of(monkeypatch: pytest.MonkeyPatch) -> list[object]:
    """Return a list that grows with every sum that a comparison of a record with its model makes: it asks for its size."""
    sums: list[object] = []
    size = np.abs

    def counted(value: object) -> object:
        sums.append(value)
        return size(value)  # type: ignore[call-overload]

    monkeypatch.setattr(np, "abs", counted)
    return sums


def test_no_slot_waits_until_a_block_is_compared(monkeypatch: pytest.MonkeyPatch) -> None:
    loop = loop_of(Plant(), Table())
    step = loop.watched and loop.watched.plant
    assert isinstance(step, OneStep) and np.count_nonzero(step.taps) > 3
    watch = PlantWatch(step, lambda which: pytest.fail("a plant at rest is not run again"), lambda k: (0.0,), 1_000_000)
    sums = sums_of(monkeypatch)
    in_slot = []
    for _ in range(2 * BLOCK):
        before = len(sums)
        watch.take([0.0] * (step.taps.shape[2] - 2), [0.0], [0.0], [0.0])
        in_slot.append(len(sums) - before)
    assert sum(in_slot) > np.count_nonzero(step.taps) and max(in_slot) == 1 and not any(in_slot[: BLOCK - 1])
    assert watch.departed() is None and len(sums) > 2 * np.count_nonzero(step.taps)


def test_a_sweep_says_it_of_its_first_run() -> None:
    experiment = loop_of(Plant("unstable after slot 300"), Table()).experiment
    found = hil.sweep(experiment, runs=2, jobs=1)
    assert found.caution.startswith("certificate withdrawn: the plant left its model at slot 30")
