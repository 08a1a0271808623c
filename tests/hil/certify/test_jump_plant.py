"""A plant that jumps hands over its own numbers: ours, and a foreign one's."""

from __future__ import annotations

import dataclasses
import math
import runpy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

import design.as_printed as examples
import hil
from design.controllers import Constant, LoopModel, OutputFeedback, SendAll
from design.requests.scheduled import RobustScheduled, Scheduled
from hil.certify.certify import judge
from hil.certify.conformance import plant_check, without_loop
from hil.certify.jump_loop import jump_step, process_of, system_of
from hil.compose import compose
from hil.errors import ExperimentError
from hil.experiment import Seconds, load_experiment
from hil.experiment.rig_tables import Limits
from hil.plugins.checks import check_controller
from hil.runtime.virtual import simulate
from plants import (
    DCMotor,
    DelayedVTOL,
    FaultyVTOL,
    JumpModel,
    JumpRates,
    PlantError,
    Signal,
    SwitchedExample,
    TransitionRates,
    check_plant,
)
from tests.hil.compose.random_loops import jump_loop

TwoSpeedTank: Any = runpy.run_path(str(Path(__file__).with_name("two_speed_tank.py")))["TwoSpeedTank"]


def rates(process: Any, h: float) -> np.ndarray[Any, Any]:
    return np.array([process.rate(mode, h) for mode in range(process.modes)])


SOJOURNS = (0.0, 0.2, 0.31, 0.9, 1.7, 1.9, 2.5, 3.7, 9.0)


def test_the_switched_example_is_that_of_chapter_2() -> None:
    ours, printed = system_of(SwitchedExample(uncertainty="none").jump_system()), examples.chapter2_system("none")
    np.testing.assert_array_equal(ours.a, printed.a)
    np.testing.assert_array_equal(ours.b, printed.b)
    for h in SOJOURNS:
        mine = rates(process_of(SwitchedExample().jump_process()), h)
        np.testing.assert_allclose(mine, rates(examples.chapter2_process(), h), rtol=1e-14)


def test_the_hull_of_the_switched_example_holds_what_sigma_and_rho_can_do() -> None:
    plant = SwitchedExample(uncertainty_scale=1.5)
    system = system_of(plant.jump_system())
    low, high = system.uncertainty.da.min(axis=0), system.uncertainty.da.max(axis=0)  # type: ignore[union-attr]
    for sigma, rho in np.random.default_rng(0).uniform(-1.5, 1.5, (50, 2)):
        for mode in (1, 2):
            off = np.array(plant.matrices(mode, sigma, rho)[0]) - system.a[mode - 1]
            assert (off >= low[mode - 1] - 1e-12).all() and (off <= high[mode - 1] + 1e-12).all()
    fixed = SwitchedExample(uncertainty_scale=12.0, sigma=1.0, rho=1.0)
    certain = system_of(fixed.jump_system())
    assert certain.uncertainty is None  # type: ignore[union-attr]
    np.testing.assert_allclose(certain.a[0], fixed.matrices(1, 12.0, 12.0)[0])


def test_the_delayed_vtol_is_that_of_chapter_3() -> None:
    ours, printed = system_of(DelayedVTOL().jump_system()), examples.chapter3_system()
    for name in ("a", "ad", "b", "c", "e", "delay_slopes"):
        np.testing.assert_allclose(getattr(ours, name), getattr(printed, name), rtol=1e-14, err_msg=name)
    assert ours.delay_max_s == printed.delay_max_s  # type: ignore[union-attr]
    for h in SOJOURNS:
        np.testing.assert_allclose(
            rates(process_of(DelayedVTOL().jump_process()), h), rates(examples.chapter3_process(), h), rtol=1e-13
        )


def test_the_faulty_vtol_is_that_of_chapter_4() -> None:
    ours, printed = system_of(FaultyVTOL().jump_system()), examples.chapter4_system()
    for name in ("a", "b", "c", "e"):
        np.testing.assert_allclose(getattr(ours, name), getattr(printed, name), rtol=1e-14, err_msg=name)
    mine: Any = process_of(FaultyVTOL().jump_process())
    theirs = examples.chapter4_process(failure_restarts_detection_clock=False)
    pairs = [(mine.failure, theirs.failure), *zip(mine.detection, theirs.detection, strict=True)]
    for h in SOJOURNS:
        for one, other in pairs:
            np.testing.assert_allclose(rates(one, h), rates(other, h), rtol=1e-13)


def tank_loop(**changes: Any) -> Any:
    plain = load_experiment("smjls-robust", ["period=20 ms", "duration=5"])
    given: dict[str, Any] = {"plant": TwoSpeedTank(), "controller": RobustScheduled(gain_bound=4.0, decay=0.5)}
    given |= {"allow_uncertified": False, **changes}
    return compose(replace(plain, limits=Limits(), kinds={}, **given))


def test_a_users_jump_plant_gets_gains_a_verdict_and_a_run() -> None:
    assert any("is a JumpPlant" in sentence for sentence in check_plant(TwoSpeedTank()))
    loop = tank_loop()
    assert loop.verdict.certified and loop.verdict.details["continuous_time"] == "certified"
    assert not any("not met" in each for each in loop.verdict.assumptions), "a run in which both modes are seen"
    assert max(abs(k) for mode in loop.controller.gain for section in mode for row in section for k in row) <= 4.0 + 1e-9
    level = simulate(loop, 1).arrays["/plant/state"]["level"]
    assert abs(level[-1]) < 0.1 * abs(level[0])
    assert any("is a ModeSchedule" in sentence for sentence in check_controller(loop.controller, loop.model))


@pytest.mark.parametrize(("shown", "state"), [((1, 2, 3), None), ((1, 3, 2), "refused")])
def test_two_jumps_in_a_step_of_the_count_are_none_that_the_rates_lack(shown: tuple[int, ...], state: str | None) -> None:
    """Three modes that follow each other: a right plant seems to skip one now and then, one that goes backwards always does."""

    class Ring(TwoSpeedTank):  # type: ignore[misc]
        def jump_process(self) -> JumpRates:
            matrix = ((-1.0, 1.0, 0.0), (0.0, -1.0, 1.0), (1.0, 0.0, -1.0))
            return JumpRates(rates=TransitionRates(nodes_s=(0.0,), rates=(matrix,)))

        def start(self, rng: np.random.Generator) -> Any:
            run = super().start(rng)
            run.measure = lambda: (run._x, float(shown[run._mode]))
            return run

    tank = Ring(growth=(-0.5,) * 3, effect=(1.0,) * 3, rate=1.0)
    model = LoopModel(A=np.eye(1), B=np.zeros((1, 1)), C=[[1.0], [0.0]], period_s=0.1, tau_max=0, d_max=0)
    found, said = plant_check(without_loop(tank, model))
    assert found == state, said


@pytest.mark.parametrize(("rises", "state"), [(-0.0005, None), (0.0005, "refused")])
def test_a_slow_state_beside_a_fast_one_is_compared_by_its_own_speed(rises: float, state: str | None) -> None:
    """x1' = -100 x1 + 100 u hides 1e-4 of its speed: all that decides whether x2' = -0.0005 x2 + u falls."""

    class Beside(TwoSpeedTank):  # type: ignore[misc]
        outputs = states = (Signal("fast", "m"), Signal("slow", "m"), Signal("mode", "1"))

        def jump_system(self) -> JumpModel:
            return JumpModel(A=(((-100.0, 0.0), (0.0, -0.0005)),) * 2, B=(((100.0,), (1.0,)),) * 2)

        def start(self, rng: np.random.Generator) -> Any:
            return Both(super().start(rng))

    class Both:
        def __init__(self, run: Any) -> None:
            self.run, self.slow = run, 1.0

        def advance(self, dt_ns: int, u: Any, w: Any = ()) -> None:
            self.run.advance(dt_ns, u, w)
            self.slow += (self.slow + u[0] / rises) * math.expm1(rises * dt_ns / 1e9)

        def measure(self) -> tuple[float, ...]:
            fast, mode = self.run.measure()
            return (fast, self.slow, mode)

        state = property(measure)

    plant = Beside(growth=(-100.0, -100.0), effect=(100.0, 100.0))
    model = LoopModel(A=np.eye(2), B=np.ones((2, 1)), C=np.eye(2), period_s=0.05, tau_max=0, d_max=0)
    found, said = plant_check(without_loop(plant, model))
    assert found == state, said
    assert state is None or "its speed in slot" in said


def test_gains_that_a_users_plant_outgrew_are_not_certified() -> None:
    gains = tank_loop().controller
    with pytest.raises(ExperimentError, match="no certificate of mean-square stability, refused"):
        tank_loop(controller=gains, plant=TwoSpeedTank(growth=(0.2, 9.0)))


def test_a_longer_period_turns_the_verdict_of_the_same_gains() -> None:
    gains = tank_loop().controller
    found = [tank_loop(controller=gains, period=Seconds(T), allow_uncertified=True).verdict for T in (0.02, 0.2, 2.0)]
    assert [verdict.state for verdict in found] == ["certified", "certified", "refused"]
    assert max(found[0].number, found[1].number) < 1.0
    assert "no finite mean at the end of a stay in a mode" in found[-1].reason
    assert found[-1].number is None  # JSON has no infinity


def test_a_jump_plant_whose_matrices_do_not_fit_is_named() -> None:
    @dataclasses.dataclass(frozen=True, kw_only=True)
    class Odd(TwoSpeedTank):  # type: ignore[misc]
        def jump_system(self) -> Any:
            return dataclasses.replace(TwoSpeedTank().jump_system(), B=(((1.0, 2.0),), ((1.0, 2.0),)))

    with pytest.raises(PlantError, match=r"Odd\.jump_system: B of shape \(1, 2\)"):
        check_plant(Odd())


def test_a_jump_plant_that_no_theory_covers_gets_no_gains_and_the_reason() -> None:
    @dataclasses.dataclass(frozen=True, kw_only=True)
    class Both(TwoSpeedTank):  # type: ignore[misc]
        def jump_system(self) -> Any:
            own = TwoSpeedTank().jump_system()
            late = {"Ad": own.A, "max_delay_s": 0.1, "delay_slopes": (0.0, 0.0)}
            return dataclasses.replace(own, changes=((own.A, own.B),), **late)

    with pytest.raises(ExperimentError, match=r"controller\.kind: no design covers this plant: changes: no theory covers"):
        tank_loop(plant=Both())


@dataclasses.dataclass(frozen=True, kw_only=True)
class _Unstated:
    """A tank that shows its mode and states no modes: both are alike."""

    tank: Any = dataclasses.field(default_factory=lambda: TwoSpeedTank(growth=(0.2, 0.2), effect=(1.0, 1.0)))
    inputs, outputs, states = TwoSpeedTank.inputs, TwoSpeedTank.outputs, TwoSpeedTank.states

    def model(self) -> Any:
        return self.tank.model()

    def start(self, rng: np.random.Generator) -> Any:
        return self.tank.start(rng)


def test_gains_by_mode_over_a_plant_that_states_no_modes_are_undecided() -> None:
    one = (((-1.0,),),)
    gains = Scheduled(gain=(one, one), starts_s=((0.0,),) * 2)
    verdict = tank_loop(plant=_Unstated(), controller=gains, allow_uncertified=True).verdict
    assert verdict.state == "undecided" and "[plant] _Unstated states no modes (jump_system()" in verdict.reason


def test_a_least_delay_above_the_largest_is_refused_and_one_within_keeps_the_loop_undecided() -> None:
    @dataclasses.dataclass(frozen=True, kw_only=True)
    class Late(TwoSpeedTank):  # type: ignore[misc]
        least: float = 0.0

        def jump_system(self) -> Any:
            own = TwoSpeedTank().jump_system()
            return dataclasses.replace(
                own, Ad=tuple(((9.0,),) for _ in own.A), max_delay_s=0.1, min_delay_s=self.least, delay_slopes=(0.3,) * len(own.A)
            )

    with pytest.raises(PlantError, match=r"Late\.jump_system: min_delay_s 0\.2, expected 0 to max_delay_s \(0\.1\)"):
        check_plant(Late(least=0.2))
    two = JumpModel(
        A=(((0.2,),),) * 2, Ad=(((-0.1,),),) * 2, B=(((1.0,),),) * 2, max_delay_s=0.5, delay_slopes=(0.3, 0.3)
    )  # fmt: skip
    process = JumpRates(rates=TransitionRates(nodes_s=(0.0,), rates=(((-1.0, 1.0), (1.0, -1.0)),)))
    for least, state in ((0.0, "refused"), (0.05, "undecided")):
        system = dataclasses.replace(two, min_delay_s=least)
        found = judge(jump_loop(np.random.default_rng(0), system, process, np.zeros((2, 1, 1)), 0.05, 0))
        assert found.state == state, found.reason
    assert "the plant has 0.05 s at least" in found.reason


@dataclasses.dataclass(frozen=True, kw_only=True)
class _Settles(TwoSpeedTank):  # type: ignore[misc]
    """It stays in its first mode for ever; from the second, in which no valve helps, it would come back."""

    first: tuple[int, ...] = (1,)

    def jump_process(self) -> JumpRates:
        return JumpRates(rates=TransitionRates(nodes_s=(0.0,), rates=(((0.0, 0.0), (0.5, -0.5)),)), initial=self.first)

    def start(self, rng: np.random.Generator) -> Any:
        run = super().start(rng)
        run._left_ns = 1 << 60
        return run


@pytest.mark.parametrize(
    ("first", "state", "reason"),
    [
        ((1,), "certified", ""), ((), "refused", "have no finite mean at the end of a stay in a mode"),
        ((2,), "refused", "it begins in mode 1, and states that it begins in 2"),
    ],
)  # fmt: skip
def test_a_mode_that_no_run_comes_to_decides_nothing(first: tuple[int, ...], state: str, reason: str) -> None:
    """The second mode grows faster than it is left: a run that may begin there is refused, and this plant never does."""
    plant = _Settles(growth=(0.2, 3.0), effect=(1.0, 1.0 if first == (2,) else 0.0), first=first)
    one = (((-9.0 if first == (2,) else -1.0,),),)
    gains = Scheduled(gain=(one, one), starts_s=((0.0,),) * 2)
    changes = {"allow_uncertified": True, "period": "50 ms", "limits": {}}
    verdict = compose(hil.load_experiment("smjls-robust", plant=plant, controller=gains, **changes)).verdict
    assert verdict is not None and verdict.state == state and reason in verdict.reason, verdict


def test_a_detected_mode_that_no_run_comes_to_is_left_out() -> None:
    """Failure and detection: from the sound mode, which is never left, a detection that is never wrong stays right."""
    still, back = ((0.0, 0.0), (1.0, -1.0)), ((-1.0, 1.0), (0.0, 0.0))
    tables = [TransitionRates(nodes_s=(0.0,), rates=(rates,)) for rates in (still, still, back)]
    process = JumpRates(rates=tables[0], detection=(tables[1], tables[2]), initial=(1,), initial_detected=(1,))
    assert process.reached() == ([0], [0])
    assert dataclasses.replace(process, initial_detected=(2,)).reached() == ([0], [0, 1])
    assert dataclasses.replace(process, initial=()).reached() == ([0, 1], [0, 1])
    system = JumpModel(A=(((-1.0,),), ((9.0,),)), B=(((1.0,),), ((0.0,),)))
    loop = jump_loop(np.random.default_rng(0), system, process, np.array([[[-1.0]], [[99.0]]]), 0.05, 0)
    assert judge(loop).certified
    unsure = dataclasses.replace(loop.plant, process=dataclasses.replace(process, initial=(), initial_detected=()))  # type: ignore[type-var]
    assert judge(replace(loop, plant=unsure, said={})).state == "refused"
    with pytest.raises(ValueError, match="initial: 3, expected a mode from 1 to 2"):
        JumpRates(rates=tables[0], initial=(3,))


def test_checks_say_what_a_plug_in_is_and_what_that_earns() -> None:
    assert "DCMotor is no JumpPlant" in check_plant(DCMotor())[1]
    assert "friction" in check_plant(DCMotor.experimental(), tolerance=1.0)[2]
    model = LoopModel(A=np.eye(1), B=np.eye(1), C=np.eye(1), period_s=0.1, tau_max=0, d_max=0)
    gains = SendAll(gains=((((0.5,),),),))
    assert any("is a GainTable" in sentence for sentence in check_controller(gains, model))
    one = ((0.5,),)
    observer, constant = OutputFeedback(A=one, B=one, C=one, D=one), Constant(value=(0.0,))
    assert any("LinearFeedback: linear with states" in sentence for sentence in check_controller(observer, model))
    assert not any("allow_uncertified" in sentence for sentence in check_controller(observer, model))
    assert any("only. State table(model)" in sentence for sentence in check_controller(constant, model))
    with pytest.raises(AssertionError, match=r"gains of shape \(1, 2\), expected \(1, 0\)"):
        check_controller(_Blind(gain=((((1.0, 1.0),),),), starts_s=((0.0,),)), model)


class _Blind(Scheduled):
    def start(self, model: LoopModel) -> Any:
        return Constant(value=(0.0,)).start(model)


def test_what_a_record_fulfils_is_the_flow_of_a_mode_within_what_is_uncertain_and_the_jumps_that_a_slot_hides() -> None:
    """x' = a x + b u with a in [0.2, 0.3] or [1, 1.4] and b in [0.9, 1.1] or [0.8, 0.8]; 0.5 jumps per s."""
    tank = TwoSpeedTank()
    model = LoopModel(A=np.eye(1), B=np.eye(1), C=np.eye(1), period_s=0.2, tau_max=0, d_max=0)
    growth, away, effect = np.array([0.2, 1.0]), np.array([0.1, 0.4]), np.array([1.0, 0.8])

    class Uncertain(TwoSpeedTank):
        hidden = ()

        def jump_system(self) -> JumpModel:
            changes = (((((0.1,),), ((0.4,),)), (((0.1,),), ((0.0,),))), ((((0.0,),), ((-0.2,),)), (((-0.1,),), ((0.0,),))))
            return dataclasses.replace(tank.jump_system(), changes=changes)

        def jump_process(self) -> JumpRates:
            return dataclasses.replace(tank.jump_process(), detection=self.hidden)

    step, wide = jump_step(tank, model), jump_step(Uncertain(), model)
    assert step is not None and wide is not None and step.seen and step.unseen == pytest.approx(0.1**2)
    held = np.expm1(0.2 * growth) / growth
    assert np.allclose(step.flows[:, 0], np.column_stack([np.exp(0.2 * growth), held * effect])) and not step.bands.any()
    farther = np.exp(0.2 * (growth + away)) - np.exp(0.2 * growth)
    assert np.array_equal(wide.flows, step.flows) and np.allclose(wide.bands[:, 0, 0], farther)
    pushed = np.expm1(0.2 * (growth + away)) / (growth + away) * (effect + [0.1, 0.0]) - held * effect
    assert np.allclose(wide.bands[:, 0, 1], pushed)
    Uncertain.hidden = (tank.jump_process().rates,) * 2
    unseen = jump_step(Uncertain(), model)
    assert unseen is not None and not unseen.seen and unseen.unseen == pytest.approx(0.1)
