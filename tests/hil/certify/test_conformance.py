"""What plants and controllers do beside what they say: no plug-in that lies is certified, none that is honest is refused."""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar

import msgspec
import numpy as np
import pytest

import hil
from design.controllers import LoopModel, OutputFeedback
from design.controllers.historical import Historical, HistoricalRun
from design.controllers.virtual_wall import VirtualWall
from design.verdict import Verdict
from hil.api.experiment_source import load_experiment
from hil.certify.answers_test import scheduled_excitation
from hil.certify.conformance import plant_check, without_loop
from hil.certify.stated_controller import wall_excitation
from hil.compose import compose
from hil.errors import ExperimentError
from plants import LinearPlant, Signal, StateSpace, SwitchedExample
from plants.switched_example import SwitchedExampleRun
from tests.hil.compose.lying_plugins import ANSWERS, CONDITIONS, HONEST, PLANT_LIES, TABLE_LIES, Plant, Rowed, Run, Table


def verdict_on(name: str = "dc-motor-h2", **changes: Any) -> Verdict:
    found = compose(load_experiment(name, allow_uncertified=True, **changes)).verdict
    assert found is not None
    return found


def on_own(plant: Plant | None = None, controller: Table | None = None) -> Verdict | None:
    """The verdict on the motor with a part of one's own; None where the loop is refused before one is asked for."""
    given = {"controller": {"kind": "local", "gain": [[-0.05]]} if controller is None else controller}
    try:
        return verdict_on(**given | ({} if plant is None else {"plant": plant}), **{"limits.state": {}})
    except ExperimentError as error:
        assert "check_plant" in str(error) or "check_controller" in str(error)
        return None


@pytest.mark.parametrize("lie", PLANT_LIES)
def test_a_plant_that_is_not_its_model_is_not_certified(lie: str) -> None:
    found = on_own(Plant(lie))
    if "huge inputs" in lie:  # beyond the limit of the run: no input is ever so large, and the verdict says how far it was tested
        assert found is not None and any("of 0.005 to 5 V" in said for said in found.assumptions)
    else:
        assert found is None or not found.certified, lie


@pytest.mark.parametrize("lie", ["none", *HONEST])
def test_a_load_or_noise_of_an_own_plant_is_no_departure_and_is_named(lie: str) -> None:
    found = on_own(Plant(lie))
    assert found is not None and found.certified, found
    assert any("the plant moves as its model says: compared over" in said for said in found.assumptions)
    assert any(lie.split()[0] in said for said in found.assumptions) or lie == "none"


@dataclass(frozen=True, kw_only=True)
class Upright:
    """angle'' = 20 sin(angle) + gain torque, a pendulum that begins beside its upper point of rest; its model has gain 4."""

    start_rad: float = 0.0
    gain: float = 4.0
    inputs: ClassVar = (Signal("torque", "N m"),)
    outputs: ClassVar = (Signal("angle", "rad"),)
    states: ClassVar = (Signal("angle", "rad"), Signal("speed", "rad/s"))

    def model(self) -> StateSpace:
        return StateSpace(A=[[0.0, 1.0], [20.0, 0.0]], B=[[0.0], [4.0]], C=[[1.0, 0.0]])

    def start(self, rng: np.random.Generator) -> Falls:
        return Falls(self)


class Falls:
    def __init__(self, plant: Upright) -> None:
        self.plant, self.state, self.applied = plant, (plant.start_rad, 0.0), (0.0,)

    def advance(self, dt_ns: int, u: Sequence[float], w: Sequence[float] = ()) -> None:
        self.applied = (u[0],)
        (angle, speed), h, torque = self.state, dt_ns * 1e-9 / 50, u[0] + sum(w)
        for _ in range(50):  # of second order, and exact to 1e-9 in such short steps
            middle = speed + h / 2 * (20.0 * math.sin(angle) + self.plant.gain * torque)
            speed += h * (20.0 * math.sin(angle + h / 2 * speed) + self.plant.gain * torque)
            angle += h * middle
        self.state = (angle, speed)

    def measure(self) -> tuple[float, ...]:
        return self.state[:1]


@pytest.mark.parametrize(
    ("plant", "state", "said"),
    [
        (Upright(start_rad=0.3), "undecided", "non-linear: .* of the motion that small inputs cause depends on when they begin"),
        (Upright(gain=-4.0), "refused", "your plant does not move as its model"),
        (Upright(), "undecided", ""),
    ],
    ids=["beside its point of rest", "another gain", "at rest"],
)
def test_a_plant_that_begins_where_its_model_is_not_made_is_no_liar(plant: Upright, state: str, said: str) -> None:
    """What it does under small inputs is that of another point, and the model's of its own: neither refutes the other."""
    model = plant.model().discretise(0.01)
    A, B, C = (np.asarray(matrix) for matrix in (model.A, model.B, model.C))
    found = plant_check(without_loop(plant, LoopModel(A=A, B=B, C=C, period_s=0.01, tau_max=0, d_max=0)))
    assert found[0] == state and re.match(said, str(found[1])), found


@pytest.mark.parametrize(("units", "said"), [(("V", "V"), "1e+06 V"), (("1/s", "1/s"), "1e+06 1/s"), (("kW", "kg/s"), "1e+06")])
def test_the_unit_of_random_inputs_is_one_that_all_have(units: tuple[str, str], said: str) -> None:
    inputs = tuple(Signal(f"u{i}", unit) for i, unit in enumerate(units))
    plant = LinearPlant(A=((-1.0,),), B=((1.0, 2.0),), C=((1.0,),), inputs=inputs)
    model = plant.model().discretise(0.05)
    A, B, C = (np.asarray(matrix) for matrix in (model.A, model.B, model.C))
    state, found = plant_check(without_loop(plant, LoopModel(A=A, B=B, C=C, period_s=0.05, tau_max=0, d_max=0)))
    assert state is None and found[0].endswith(f"random inputs of 0.001 to {said}")


def test_without_limits_a_plant_is_tested_up_to_a_million() -> None:
    assert "huge inputs" in CONDITIONS
    found = verdict_on(plant=Plant("turned, huge inputs"), controller=Table(), limits={})
    assert found.state == "undecided" and found.reason.startswith("non-linear: ") and "1e+06 V" in found.reason


def test_the_number_stands_in_the_refusal() -> None:
    with pytest.raises(ExperimentError, match=r"your plant does not move as its .* says: inputs up to 0.005 V move"):
        hil.run("dc-motor-h2", plant=Plant("turned, always"), controller=Table(), **{"limits.state": {}})


class Fragile(Plant):
    """It breaks in slot 40, if an input moves it."""

    def start(self, rng: np.random.Generator) -> Run:
        return FragileRun(self, rng)


class FragileRun(Run):
    def advance(self, dt_ns: int, u: Sequence[float], w: Sequence[float] = ()) -> None:
        super().advance(dt_ns, u, w)
        if self.k >= 40 and u[0]:
            raise RuntimeError("it broke")


def test_a_plant_that_departs_from_its_model_and_then_raises_is_refused_for_the_first() -> None:
    found = on_own(Fragile("turned, always"))
    assert found is not None and found.state == "refused" and "your plant does not move as its model() says" in found.reason
    found = on_own(Fragile())
    assert found is not None and found.state == "undecided"
    assert re.fullmatch(rf"the plant could not be compared .*: RuntimeError: it broke \({__file__}, line \d+\)", found.reason)


class LateTable(Table):
    """It fails in a slot behind those in which a check asks it."""

    def __init__(self, late: Callable[[], Any]) -> None:
        super().__init__()
        object.__setattr__(self, "late", late)

    def start(self, model: LoopModel) -> Rowed:
        return LateRun(self, model)


class LateRun(Rowed):
    def rows(self, k: int, tau: int, y: Sequence[float], r: Sequence[float]) -> Any:
        return self.table.late() if k > 300 else super().rows(k, tau, y, r)  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("late", "said"),
    [
        (lambda: ((1.0, 2.0), (1.0,)), "LateTable: it returned something of another form than in its check: ValueError: "),
        (lambda: int("a"), rf"ValueError: .*'a' \({__file__}, line \d+\)"),
        (lambda: sys.exit(0), rf"SystemExit: 0 \({__file__}, line \d+\)"),
    ],
)
def test_a_controller_that_fails_in_late_slots_is_undecided_with_its_line(late: Callable[[], Any], said: str) -> None:
    found = on_own(controller=LateTable(late))
    assert found is not None and found.state == "undecided"
    assert re.match(f"the controller could not be compared with what it says: {said}", found.reason)


@pytest.mark.parametrize("lie", TABLE_LIES)
def test_a_controller_that_is_not_its_table_is_not_certified(lie: str) -> None:
    found = on_own(controller=Table(lie))
    assert found is None or not found.certified, lie


def test_who_says_to_be_equal_to_all_is_compared_by_its_answers() -> None:
    class Equal(Table):
        def __eq__(self, other: object) -> bool:
            return True

        __hash__ = Table.__hash__

    found = on_own(controller=Equal("last row"))
    assert found is not None and found.state == "refused"


@pytest.mark.parametrize(("other", "same"), [("small", "large"), ("large", "small")])
def test_a_controller_that_is_its_table_on_samples_of_one_size_alone_is_non_linear(other: str, same: str) -> None:
    found = on_own(controller=Table(f"{other} samples"))
    assert found is not None and found.state == "undecided"
    assert found.reason.startswith(f"non-linear: the controller answers as its table says on {same} samples, but on samples up")


@pytest.mark.parametrize("selection", ["constant", "generated", "previous", "both"])
@pytest.mark.parametrize("lie", ["last row", "of age 1", "a state"])
def test_every_information_pattern_is_tested(selection: Any, lie: str) -> None:
    liar = on_own(controller=Table(lie, selection=selection))
    assert liar is not None and liar.state == "refused"


@pytest.mark.parametrize("selection", ["constant", "generated", "previous", "both"])
def test_a_controller_that_keeps_its_table_is_certified_for_every_information_pattern(selection: Any) -> None:
    honest = on_own(controller=Table(selection=selection))
    assert honest is not None and honest.certified


def test_a_second_sample_and_an_integral_are_tested() -> None:
    def second(run: Any, k: int, tau: int, y: Any, r: Any, rows: list[list[float]]) -> None:
        rows[0][0] += 0.3 * y[-1]

    ANSWERS["second sample"] = second
    two = {"network.nodes.sensor": {"outputs": ["y"], "buffer": 2}}
    for samples, changes in ((2, two), (1, {})):
        honest, liar = (
            verdict_on(
                plant=Plant(), controller=Table(lie, samples=samples, integral=samples == 1), **{"limits.state": {}}, **changes
            )
            for lie in ("none", "second sample")
        )
        assert "does not answer" not in honest.reason and liar.reason.startswith("your controller does not answer as it says")


def test_a_plant_that_takes_back_what_it_has_beyond_its_model_is_tested() -> None:
    class Coy(Plant):
        def beyond_model(self) -> tuple[str, ...]:
            asked.append(0)
            return () if len(asked) <= begins else ("friction",)

    for begins in range(6):
        asked: list[int] = []
        found = on_own(Coy("unstable, always"))
        assert found is None or not found.certified, begins


def test_an_own_feedforward_is_the_authors_affair() -> None:
    found = on_own(controller=Table("an own aim"))
    assert found is not None and found.certified


class Twisted:
    """Rows of another controller, changed by a function."""

    def __init__(self, running: Any, change: Callable[[int, Any], Any]) -> None:
        self.running, self.change, self.selection = running, change, running.selection
        if isinstance(running, HistoricalRun):
            self.memory = running.memory

    def rows(self, k: int, *asked: Any) -> Any:
        return self.change(k, self.running.rows(k, *asked))


def doubled(k: int, rows: Any) -> Any:
    return tuple(tuple(2.0 * u for u in row) for row in rows)


def test_linear_historical_and_wall_controllers_are_tested() -> None:
    feedback = OutputFeedback(A=((0.1,),), B=((1.0,),), C=((0.001,),), D=((-0.004,),))
    cases: list[tuple[Any, str, dict[str, Any]]] = [
        (OutputFeedback, "dc-motor-h2", {"controller": feedback}),
        (Historical, "multisensor-published", {}),
        (VirtualWall, "omni-push", {}),
    ]
    for law, name, changes in cases:
        before = verdict_on(name, **changes)
        assert before.certified and any("answers as" in said for said in before.assumptions), before.reason

        def lying(self: Any, model: Any, start: Any = law.start) -> Any:
            return Twisted(start(self, model), doubled)

        own = type(f"Own{law.__name__}", (law,), {"start": lying})
        controller = compose(load_experiment(name, allow_uncertified=True, **changes)).controller
        given = {field.name: getattr(controller, field.name) for field in fields(controller)}  # type: ignore[arg-type]
        found = verdict_on(name, controller=own(**given))
        assert found.state == "refused" and found.reason.startswith("your controller does not answer as it says"), found.reason


@pytest.mark.parametrize("lie", ["input", "mode 2", "rates", "none"])
def test_a_plant_that_jumps_is_tested_in_every_mode_and_in_its_rates(lie: str) -> None:
    class Run(SwitchedExampleRun):
        def _move(self, from_ns: int, to_ns: int) -> None:
            held = self._v
            if lie == "input" or (lie == "mode 2" and self._mode.mode == 2):
                self._v = (-3.0 * held[0],)
            super()._move(from_ns, to_ns)
            self._v = held

    class Own(SwitchedExample):
        def start(self, rng: np.random.Generator) -> SwitchedExampleRun:
            slow = replace(self, rate_low=0.02, rate_high=0.03) if lie == "rates" else self
            return Run(slow, rng)

    found = verdict_on("smjls-robust-published", plant=Own())
    assert found.certified is (lie == "none"), found.reason
    assert lie == "none" or found.reason.startswith("your plant does not move as its model() says")


def test_the_test_draws_nothing_from_the_run() -> None:
    noisy = Plant("noise")
    runs = [hil.run("dc-motor-h2", plant=noisy, controller=Table(), duration=1, **{"limits.state": {}}) for _ in range(2)]
    assert runs[0].summary["log"]["sha256"] == runs[1].summary["log"]["sha256"]


def test_a_departure_is_reported_with_numbers_that_differ() -> None:
    """Where the cubic spring is first felt, what moved and what the model has are the same by four digits."""
    found = verdict_on(plant=Plant("a cubic spring"), controller=Table(), **{"limits.state": {}})
    told = re.search(r"by (\S+) m where the model has (\S+) m, first in slot", found.reason)
    assert told is not None and told[1] != told[2] and float(told[1]) == pytest.approx(float(told[2]), rel=1e-4)


def test_a_wall_is_tested_by_a_device_that_is_in_it_for_half_of_the_time() -> None:
    loop = compose(load_experiment("omni-push"), certify=False)
    places = wall_excitation(loop.model, 1).samples
    assert places.shape[1] == 3 and (np.abs(places) < 2.0).all()
    assert all(0.3 < share < 0.7 for share in (places > 0.0).mean(axis=0))


def test_nodes_whose_packets_are_never_lost_are_known_in_every_turn() -> None:
    """`multisensor-published` sends what its schedule says; with losses a share of the turns is missing."""
    model = compose(load_experiment("multisensor-published"), certify=False).model
    turns = model.nodes.turns
    assert turns is not None and turns.cycle and turns.loss == 0.0
    sure = scheduled_excitation(model, memory=3).received
    nodes = msgspec.structs.replace(model.nodes, turns=msgspec.structs.replace(turns, loss=0.3))
    lossy = scheduled_excitation(msgspec.structs.replace(model, sensors=nodes), memory=3).received
    newest = [max(slot for node, slot in known if node == 0) for known in sure[10:]]
    assert max(k - s for k, s in enumerate(newest, start=10)) <= turns.phases + max(d or 0 for d in model.nodes.delays)
    assert sum(map(len, lossy)) < sum(map(len, sure))
