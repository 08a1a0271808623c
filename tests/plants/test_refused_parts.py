"""What a plant may be made of, up to its edges, and whose run it can go on with."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from plants import DCMotor, FaultyVTOL, LinearPlant, Omni
from plants.delayed_states import DelayedStates
from plants.errors import FieldError, PlantError, require_rows, require_whole_nanoseconds
from plants.parts.exponential import exp, zero_order_hold
from plants.parts.hand import Hand
from plants.parts.semi_markov import MOST_RATE, TransitionRates

RNG = np.random.default_rng(0)
HELD = Omni(hand=Hand(mass_kg=0.1, damping_n_s_per_m=1.0))
TANK = LinearPlant(A=((-1.0,),), B=((1.0,),), C=((1.0,),))
FAULTS = FaultyVTOL()
THREE = TransitionRates(nodes_s=(0.0,), rates=(((0.0,) * 3,) * 3,))


def constant(*rows: tuple[float, ...]) -> TransitionRates:
    return TransitionRates(nodes_s=(0.0,), rates=(rows,))


def rates(rate: float, stay: float | None = None) -> TransitionRates:
    return constant((-rate if stay is None else stay, rate), (0.0, 0.0))


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: replace(DelayedStates(), A=DelayedStates().A[:3]), "A"),
        (lambda: replace(DelayedStates(), A=(DelayedStates().A[0], *(row[:3] for row in DelayedStates().A[1:]))), "A"),
        (lambda: replace(DelayedStates(), B=((1.0,), (), (), ())), "B"),
        (lambda: replace(DelayedStates(), weight=DelayedStates().A[:3]), "weight"),
        (lambda: replace(HELD, encoder_noise_rad=1e-9), "encoder_noise_rad"),
        *((lambda name=name, value=value: Omni(**{name: value}), name) for name, value in (
            ("lever_m", 0.5), ("force_limit_n", 1.0), ("encoder_step_m", 1e-9), ("coulomb_n", 1e-9),
        )),
        (lambda: replace(HELD, coulomb_n=0.1, hand=Hand(mass_kg=0.1, damping_n_s_per_m=1.0, stiffness_n_per_m=1.0)), "coulomb_n"),
        (lambda: replace(FAULTS, detection=(FAULTS.detection[0], THREE)), "detection[1].rates"),
        (lambda: replace(FAULTS, detection=FAULTS.detection[:1]), "detection"),
        (lambda: replace(FAULTS, failure=THREE), "failure.rates"),
        (lambda: rates(2.0 * MOST_RATE), "rates[0][0][1]"),
        (lambda: rates(-1e-9), "rates[0][0][1]"),
        (lambda: rates(math.inf, 0.0), "rates[0][0][1]"),
        (lambda: rates(1.0, -1.0 + 1e-8), "rates[0][0]"),
        (lambda: constant((0.0, 0.0)), "rates[0][0]"),
        (lambda: constant((0.0,), (0.0, 0.0)), "rates[0][0]"),
        (lambda: require_whole_nanoseconds("at", 1.5e-9), "at"),
        (lambda: require_whole_nanoseconds("at", 0.0), "at"),
        (lambda: require_rows("A", ()), "A"),
        (lambda: require_rows("A", ((1.0,), (1.0, 2.0))), "A"),
    ],
)  # fmt: skip
def test_a_part_that_does_not_fit_is_refused_with_its_field(make: Callable[[], object], field: str) -> None:
    with pytest.raises(FieldError) as refused:
        make()
    assert refused.value.field == field


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
