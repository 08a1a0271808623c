"""Plants that lose a sensor by mode (Remark 4.1): what is measured, and what a certificate says of it."""

from __future__ import annotations

from dataclasses import fields, replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from design.as_printed import chapter4_process, chapter4_system
from design.controllers.scheduled_gain import ScheduledGain, constant_gain
from design.processes.delay_chain import DelayChain
from design.processes.rates import constant_rate
from design.processes.semi_markov import FaultDetection, SemiMarkov
from design.requests.scheduled import Scheduled
from design.semi_markov_loop import JumpSystem
from design.semi_markov_loop.certificate import JumpCertificate
from design.semi_markov_loop.fault_tolerant import fault_tolerant_feedback
from design.semi_markov_loop.fault_tolerant_analysis import analyse_fault_tolerant
from design.semi_markov_loop.sampled import sampled_verdict
from hil.api.experiment_source import load_experiment
from hil.certify.jump_loop import _with_seen_sensors, system_of
from hil.compose import compose
from hil.errors import ExperimentError
from hil.thesis import chapter4
from hil.thesis.chapter4 import GAIN_BOUND, SENSOR_FAULT, sensor_fault
from hil.thesis.statements import judge
from plants import DelayedVTOL, FaultyVTOL, check_plant
from tests.hil.thesis.judging import assert_every_number_decides

LOST = (1.0, 1.0, 1.0, 0.0)
PROCESS = chapter4_process(failure_restarts_detection_clock=False)


def lossy(lost: tuple[float, ...] = LOST) -> JumpSystem:
    system = chapter4_system()
    return JumpSystem(
        a=system.a, b=system.b[[0, 0]], c=system.c, e=system.e, sensors=np.stack([np.eye(4), np.diag(lost)])
    )


def test_a_lost_sensor_shows_zero_in_the_failed_mode_and_the_state_goes_on() -> None:
    plant = FaultyVTOL(fault_effectiveness=1.0, sensor_effectiveness=LOST)
    assert check_plant(plant)
    run, sound = (each.start(np.random.default_rng(1)) for each in (plant, FaultyVTOL(fault_effectiveness=1.0)))
    modes = set()
    for _ in range(300):
        run.advance(20_000_000, (0.1, 0.0))
        sound.advance(20_000_000, (0.1, 0.0))
        assert run.state == sound.state
        modes.add(run.state[4])
        assert run.measure()[:4] == (*run.state[:3], run.state[3] if run.state[4] == 1.0 else 0.0)
    assert modes == {1.0, 2.0}


def test_a_loop_with_sensors_is_the_loop_with_gains_k_times_s() -> None:
    """K_k S_i as gains that know both processes: the same inequalities, so the same level."""
    gain = np.random.default_rng(0).uniform(-0.05, 0.05, (2, 1, 2, 4)) + np.array([[-0.01, -0.6, 1.1, 1.2], [0.0, 1.8, 0.6, 0.1]])
    system = lossy()
    both = np.array([gain[k] @ system.shown(i) for i in range(2) for k in range(2)])
    known = ScheduledGain(gain=both, starts_s=np.zeros((4, 1)), measured=("eta", "r"))
    plain = JumpSystem(a=system.a, b=system.b, c=system.c, e=system.e)
    seen = analyse_fault_tolerant(system, ScheduledGain(gain=gain, starts_s=np.zeros((2, 1)), measured=("r",)), PROCESS)
    folded = analyse_fault_tolerant(plain, known, PROCESS)
    assert seen.certified and folded.certified
    assert seen.gamma == pytest.approx(folded.gamma, rel=1e-6) and seen.decay_rate == pytest.approx(folded.decay_rate, rel=1e-3)


def scalar(shown: float) -> tuple[JumpSystem, FaultDetection, ScheduledGain]:
    """x' = x + u, u = -3 S x, which fails for long; the detection does not matter."""
    slow, fast = constant_rate(0.1), constant_rate(5.0)
    eta, r = SemiMarkov(rates=((None, slow), (slow, None))), SemiMarkov(rates=((None, fast), (fast, None)))
    one = np.ones((2, 1, 1))
    system = JumpSystem(a=one, b=one, c=one, e=one, sensors=np.array([[[1.0]], [[shown]]]))
    process = FaultDetection(failure=eta, detection=(r, r), failure_restarts_detection_clock=False)
    return system, process, ScheduledGain(gain=-3.0 * np.ones((2, 1, 1, 1)), starts_s=np.zeros((2, 1)), measured=("r",))


@pytest.mark.parametrize(("shown", "state"), [(1.0, "certified"), (0.6, "certified"), (0.0, "refused"), (-0.2, "refused")])
def test_the_sampled_loop_sees_what_its_sensors_show(shown: float, state: str) -> None:
    system, process, gain = scalar(shown)
    assert sampled_verdict(system, process, gain, period_s=0.01).state == state
    assert analyse_fault_tolerant(system, gain, process).verdict == state
    late = sampled_verdict(system, process, gain, period_s=0.01, tau=DelayChain(transition=[[0.5, 0.5], [0.5, 0.5]]))
    assert late.state == "undecided" and "sensors that fail" in late.reason


@cache
def stored(name: str) -> ScheduledGain:
    controller = compose(load_experiment(name), certify=False).controller
    assert isinstance(controller, Scheduled)
    return controller.schedule_of_modes()


@cache
def designs() -> dict[str, Any]:
    """The numbers of the stage, of the gains that are stored: those of the shipped loop, and for sound sensors another's."""

    def feedback(system: JumpSystem, process: FaultDetection, gain_bound: float) -> JumpCertificate:
        gain = stored("vtol-fault" if system.sensors is None else "vtol-sensor-fault")
        return analyse_fault_tolerant(system, gain, process)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(chapter4, "fault_tolerant_feedback", feedback)
        return sensor_fault(lambda text, done=0, total=0, /: None)


def test_gains_are_designed_for_what_the_sensors_show() -> None:
    """With a gain of 4 at most x' = x + u settles where 0.6 of x is shown, later than where all of it is."""
    system, process, _ = scalar(0.6)
    lossy, sound = (fault_tolerant_feedback(each, process, gain_bound=4.0) for each in (system, replace(system, sensors=None)))
    assert lossy.certified and lossy.gain is not None and lossy.gain.norm <= 4.0 * (1 + 1e-12)
    assert lossy.gamma is not None and sound.gamma is not None and lossy.gamma > 1.5 * sound.gamma


def test_gains_that_know_of_the_sensor_reach_less_than_those_for_sound_ones() -> None:
    """In the loop that loses it; they are within the bound that both were asked for."""
    ours = designs()["ours"]
    assert ours.certified and ours.gain.norm <= GAIN_BOUND * (1 + 1e-12)
    assert ours.gamma < designs()["unaware"]


class Shows(FaultyVTOL):
    """Says that it loses a sensor, and loses another one."""

    def start(self, rng: np.random.Generator) -> Any:
        given = {f.name: getattr(self, f.name) for f in fields(FaultyVTOL)}
        return FaultyVTOL(**{**given, "sensor_effectiveness": (1.0, 1.0, 0.0, 1.0)}).start(rng)


def test_a_plant_that_loses_another_sensor_than_it_says_has_no_certificate() -> None:
    assert compose(load_experiment("vtol-sensor-fault")).verdict.certified  # type: ignore[union-attr]
    bent = Shows(fault_effectiveness=1.0, sensor_effectiveness=LOST, initial_fault=2)
    with pytest.raises(ExperimentError, match="what is measured is S_i x of no mode"):
        compose(load_experiment("vtol-sensor-fault", plant=bent))


def test_sensors_that_fail_beside_a_delay_inside_have_no_theory() -> None:
    said = DelayedVTOL().jump_system()
    with pytest.raises(ValueError, match="S: no theory covers sensors that fail"):
        system_of(replace(said, S=tuple(said.A)))


def test_the_rows_on_a_lost_sensor_hold_and_turn() -> None:
    rows = judge(SENSOR_FAULT, designs())
    assert [row.verdict for row in rows] == ["reproduced", "reproduced"]
    assert_every_number_decides(rows)


def test_a_mode_that_is_seen_takes_its_sensors_into_its_gain() -> None:
    system, _, _ = scalar(0.5)
    folded, gain = _with_seen_sensors(system, constant_gain(np.array([[[-2.0]], [[-4.0]]])), hidden=False)
    assert folded.sensors is None and gain.gain.ravel().tolist() == [-2.0, -2.0]  # type: ignore[union-attr]
