"""What a plant may be made of, up to its edges, and whose run it can go on with."""

from __future__ import annotations

import inspect
import math
import re
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from typing import Any

import msgspec
import numpy as np
import pytest

from plants import VTOL, DCMotor, DelayedVTOL, FaultyVTOL, LinearPlant, LoadTorque, Omni, SwitchedExample, TransferFunction
from plants.delayed_states import DelayedStates
from plants.errors import FieldError, PlantError, require_rows, require_whole_nanoseconds
from plants.omni import DampingZone
from plants.parts.actuators import Driver, Encoder, Friction
from plants.parts.exponential import exp, zero_order_hold
from plants.parts.hand import Hand, Pace, Push, Slide
from plants.parts.semi_markov import MOST_RATE, TransitionRates

RNG = np.random.default_rng(0)
HELD = Omni(hand=Hand(mass_kg=0.1, damping_n_s_per_m=1.0))
MATRICES: Any = {"A": ((-1.0,),), "B": ((1.0,),), "C": ((1.0,),)}
TANK = LinearPlant(**MATRICES)
FAULTS = FaultyVTOL()
THREE = TransitionRates(nodes_s=(0.0,), rates=(((0.0,) * 3,) * 3,))


def replaced(part: Any, **changed: Any) -> Any:
    return (msgspec.structs.replace if isinstance(part, msgspec.Struct) else replace)(part, **changed)


def constant(*rows: tuple[float, ...]) -> TransitionRates:
    return TransitionRates(nodes_s=(0.0,), rates=(rows,))


def rates(rate: float, stay: float | None = None) -> TransitionRates:
    return constant((-rate if stay is None else stay, rate), (0.0, 0.0))


PARTS = (
    DCMotor(), LoadTorque(stop_s=1.0), DelayedStates(noise_sd=(1.0,) * 4), DelayedVTOL(), FAULTS, VTOL(), Omni(),
    LinearPlant(**MATRICES, saturation=(1.0,), process_noise=(1.0,), measurement_noise=(1.0,)),
    SwitchedExample(sigma=0.5, rho=0.5), TransferFunction(num=(1.0,), den=(1.0, 2.0)), replace(HELD, force_limit_n=1.0),
    DampingZone(from_m=0.1, damping=1.0), Hand(), Pace(speed_m_s=0.1, least_s=1.0, most_s=2.0), Push(stop_s=1.0), Slide(),
    Driver(saturation_v=1.0), Encoder(), Friction(static_v=1.0),
)  # fmt: skip
SIGNED = {
    "initial_angle_rad", "initial_speed_rad_s", "torque_v", "initial_state", "delayed_share", "fault_effectiveness",
    "sensor_effectiveness", "sigma", "rho", "num", "den", "from_m", "reach_m", "force_n", "y_m", "z_m", "heading_rad",
}  # fmt: skip
"""Fields that take a number below 0."""
NOT_ZERO = {
    "gain", "stop_s", "period_s", "max_delay_s", "noise_period_s", "substep_s", "inertia", "lever_m", "force_limit_n",
    "saturation", "noise_step_s", "rate_high", "rate_slope", "uncertainty_period_s", "num", "den", "approach_s", "least_s",
    "most_s", "tremor_correlation_s", "tremor_hold_s", "turn_s", "saturation_v",
}  # fmt: skip


@pytest.mark.parametrize("part", PARTS, ids=lambda part: type(part).__name__)
def test_each_number_is_refused_by_its_name_where_it_is_none_or_too_small(part: Any) -> None:
    for name, value in ((each, getattr(part, each)) for each in inspect.signature(type(part)).parameters):
        if not isinstance(value, float) and not (isinstance(value, tuple) and value and isinstance(value[0], float)):
            continue
        for wrong in (math.nan, math.inf, -math.inf, -1e-9, 0.0):
            taken = (wrong == 0.0 and name not in NOT_ZERO) or (wrong == -1e-9 and name in SIGNED)
            changed = {name: wrong if isinstance(value, float) else (wrong, *value[1:])}
            with nullcontext() if taken else pytest.raises(FieldError) as refused:
                replaced(part, **changed)
            assert taken or refused.value.field.partition("[")[0] == name
        if isinstance(value, tuple) and name not in ("num", "den"):
            with pytest.raises(FieldError, match=f"^{name}: .*expected"):
                replaced(part, **{name: (*value, 1.0)})


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: replace(DelayedStates(), A=DelayedStates().A[:3]), "A: "),
        (lambda: replace(DelayedStates(), A=(DelayedStates().A[0], *(row[:3] for row in DelayedStates().A[1:]))), "A: "),
        (lambda: replace(DelayedStates(), B=((1.0,), (), (), ())), "B: "),
        (lambda: replace(DelayedStates(), weight=DelayedStates().A[:3]), "weight: "),
        (lambda: replace(HELD, encoder_noise_rad=1e-9), "encoder_noise_rad: "),
        *((lambda name=name, value=value: Omni(**{name: value}), f"{name}: belongs to the held device") for name, value in (
            ("lever_m", 0.135), ("force_limit_n", 1.0), ("encoder_step_m", 1e-9), ("coulomb_n", 1e-9),
        )),
        (lambda: replace(HELD, coulomb_n=0.1, hand=Hand(mass_kg=0.1, stiffness_n_per_m=1.0)), "coulomb_n: "),
        (lambda: Push(start_s=1.0, stop_s=0.5), "stop_s: 0.5, expected a finite number above start_s (1.0)"),
        (lambda: LoadTorque(start_s=2.0, stop_s=1.0), "stop_s: "), (lambda: Slide(way="jump"), "way: 'jump', expected one of"),
        (lambda: Driver(saturation_v=0.05, pwm_step_v=0.2), "pwm_step_v: 0.2 V is above the supply, saturation_v = 0.05 V"),
        (lambda: Friction(coulomb_v=0.2, static_v=0.1), "static_v: 0.1, expected at least coulomb_v (0.2)"),
        (lambda: VTOL(airspeed_kn=100), "airspeed_kn: 100, expected one of 60, 135, 170"),
        (lambda: DelayedVTOL(initial_mode=4), "initial_mode: 4, expected a mode from 1 to 3"),
        (lambda: DelayedVTOL(delay_rates=(0.1, -0.2, 0.1)), "delay_rates[1]: -0.2"),
        (lambda: DelayedVTOL(rates=TransitionRates.clipped(low=0.1, high=1.0)), "rates.rates: 2 modes, expected 3"),
        (lambda: DelayedVTOL(substep_s=1.5e-9), "substep_s: "),
        (lambda: DelayedVTOL(substep_s=1e-9), "substep_s: 1e-09 s, expected at least 1e-05 s"),
        (lambda: DelayedVTOL(substep_s=1e-5, max_delay_s=20.0), "substep_s: 1e-05, expected at least a millionth"),
        (lambda: FaultyVTOL(initial_fault=0), "initial_fault: 0, expected a mode from 1 to 2"),
        (lambda: FaultyVTOL(initial_detected=3), "initial_detected: "),
        (lambda: FaultyVTOL(detection=()), "detection: 0 tables, expected one for each of 2 fault modes"),
        (lambda: replace(FAULTS, detection=(FAULTS.detection[0], THREE)), "detection[1].rates: "),
        (lambda: replace(FAULTS, detection=FAULTS.detection[:1]), "detection: "),
        (lambda: replace(FAULTS, failure=THREE), "failure.rates: "),
        (lambda: SwitchedExample(initial_mode=3), "initial_mode: 3, expected a mode from 1 to 2"),
        (lambda: SwitchedExample(rate_high=0.05), "rate_high: 0.05, expected a finite number above rate_low"),
        (lambda: SwitchedExample(uncertainty="some"), "uncertainty: 'some', expected one of none, constant, sampled"),
        (lambda: SwitchedExample(uncertainty_form="x"), "uncertainty_form: "),
        (lambda: SwitchedExample(rho=1.5), "rho: 1.5, expected a number in [-1, 1]"),
        (lambda: rates(2.0 * MOST_RATE), "rates[0][0][1]: "),
        (lambda: rates(-1e-9), "rates[0][0][1]: "),
        (lambda: rates(math.inf, 0.0), "rates[0][0][1]: "),
        (lambda: rates(1.0, -1.0 + 1e-8), "rates[0][0]: "),
        (lambda: constant((0.0, 0.0)), "rates[0][0]: "),
        (lambda: constant((0.0,), (0.0, 0.0)), "rates[0][0]: "),
        (lambda: require_whole_nanoseconds("at", 1.5e-9), "at: "),
        (lambda: require_rows("A", ()), "A: "),
        (lambda: require_rows("A", ((1.0,), (1.0, 2.0))), "A: "),
    ],
)  # fmt: skip
def test_a_part_that_does_not_fit_is_refused_with_its_field(make: Callable[[], object], said: str) -> None:
    with pytest.raises(FieldError, match=f"^{re.escape(said)}"):
        make()


@pytest.mark.parametrize(
    "make",
    [
        lambda: rates(MOST_RATE),
        lambda: rates(0.0),
        lambda: rates(1.0, -1.0 + 1e-10),
        lambda: replace(HELD, encoder_step_m=1e-5),
        lambda: replace(HELD, coulomb_n=0.1),
        lambda: Omni(encoder_noise_rad=0.1),
        lambda: require_whole_nanoseconds("at", 3e-3) is None,
    ],
)  # fmt: skip
def test_a_part_that_just_fits_is_taken(make: Callable[[], object]) -> None:
    assert make() is not None


@pytest.mark.parametrize(
    ("plant", "other", "said"),
    [
        (DCMotor(), DCMotor(gain=100.0), None), (DCMotor(), TANK, "go_on: a LinearRun, expected a motor"),
        (HELD, replace(HELD, coulomb_n=0.1), None), (HELD, Omni(), "go_on: a bare joint, expected a device that a hand holds"),
        (Omni(), HELD, "go_on: a bare joint, expected a device that a hand holds"),
        (TANK, replace(TANK, A=((-2.0,),)), None), (TANK, DCMotor(), "go_on: a DCMotorRun, expected a plant with the same"),
        (replace(TANK, saturation=(1.0,)), replace(TANK, saturation=(2.0,)), None),
        (replace(TANK, saturation=(1.0,)), TANK, "go_on: a LinearRun, expected a plant with the same limits and noises"),
    ],
)  # fmt: skip
def test_a_plant_goes_on_where_one_of_its_kind_is(plant: Any, other: Any, said: str | None) -> None:
    run = other.start(np.random.default_rng(0))
    with nullcontext() if said is None else pytest.raises(PlantError, match=said):
        assert plant.go_on(run).state == run.state


def test_time_does_not_run_backwards_and_an_exponential_ends() -> None:
    run = HELD.start(RNG)
    run.advance(0, (0.0,))
    with pytest.raises(PlantError, match="advance: -1 ns, expected a time that does not run backwards"):
        run.advance(-1, (0.0,))
    for x in (math.inf, math.nan, 1e300):
        with pytest.raises(PlantError, match="expected a finite number of modest size"):
            exp(x)
    assert exp(700.0) == pytest.approx(math.exp(700.0), rel=1e-12)
    with pytest.raises(PlantError, match="an entry is too large for a float"):
        zero_order_hold(((800.0,),), ((1.0,),), (1, 1))
