"""What a request of a design, a wall or a chain may be, up to its edges, and what is refused with its field."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from design.controllers.send_all import SendAll
from design.controllers.wall import MATERIALS, Wall
from design.controllers.wall_pattern import Patch, Pattern
from design.errors import FieldError, check_above_zero, check_at_least_zero, check_finite
from design.passivity import HeldDevice
from design.processes.delay_chain import DelayChain
from design.processes.further_rates import ColdStandbyRate
from design.requests.historical import HistoricalDesigned
from design.requests.walls import CouplerRequest

Make = Callable[..., object]
P = [[0.5, 0.5], [0.25, 0.75]]


def chain(**values: Any) -> DelayChain:
    return DelayChain(transition=P, **values)


def tiled(material: int) -> Pattern:
    return Pattern(width_m=1.0, height_m=1.0, patches=(Patch(y_m=0.0, z_m=0.0, width_m=1.0, height_m=1.0, material=material),))


FAIR = ((1.0 / 3.0,) * 3,) * 3
PLACE = {"y_m": 0.0, "z_m": 0.0, "width_m": 1.0, "height_m": 1.0, "material": 0}
ZERO = ("damping_n_s_per_m", "hand_mass_kg", "hand_damping_n_s_per_m", "hand_stiffness_n_per_m")
DEVICE = {"mass_kg": 1e-9} | dict.fromkeys(ZERO, 0.0)
POSITIVE = [("damping_n_s_per_m", value) for value in (0.0, -1.0, math.inf, math.nan)]


@pytest.mark.parametrize(
    ("make", "values", "field"),
    [
        (CouplerRequest, {"method": "soft"}, "method"),
        (CouplerRequest, {"delays": (0, -1)}, "delays[1]"),
        *((CouplerRequest, {name: value}, name) for name, value in [*POSITIVE, ("stiffness_n_per_m", 0.0)]),
        (CouplerRequest, {"count": -1}, "count"),
        (CouplerRequest, {"varying": True, "equalise": True}, "varying"),
        (CouplerRequest, {"varying": True, "delays": (1,)}, "varying"),
        (CouplerRequest, {"varying": True, "method": "wave"}, "varying"),
        (CouplerRequest, {"method": "taps", "taps_m_per_n": (0.1,), "per_material": True}, "per_material"),
        (CouplerRequest, {"method": "taps"}, "taps_m_per_n"),
        (CouplerRequest, {"taps_m_per_n": (0.1,)}, "taps_m_per_n"),
        (Wall, {"material": -1}, "material"),
        (Wall, {"material": 3}, "material"),
        (Wall, {"pattern": tiled(0), "chain": FAIR}, "chain"),
        (Wall, {"pattern": tiled(3)}, "pattern.patches[0].material"),
        (Wall, {"chain": FAIR[:2]}, "chain[0]"),
        (Wall, {"chain": (FAIR[0], (0.5, 0.5), FAIR[0])}, "chain[1]"),
        (Wall, {"chain": (FAIR[0], FAIR[0], (1.5, -0.5, 0.0))}, "chain[2]"),
        (Wall, {"chain": (FAIR[0], FAIR[0], (0.5, 0.5, 1e-6))}, "chain[2]"),
        (Wall, {"chain_seed": -1}, "chain_seed"),
        *((Patch, PLACE | {name: value}, name) for name, value in (("y_m", math.nan), ("z_m", math.inf), ("height_m", 0.0))),
        (Pattern, {"width_m": 1.0, "height_m": 0.0, "patches": ()}, "height_m"),
        *((HeldDevice, {"mass_kg": value, "damping_n_s_per_m": 0.0}, "mass_kg") for value in (0.0, math.inf, math.nan)),
        *((HeldDevice, DEVICE | {name: -1e-9}, name) for name in DEVICE if name != "mass_kg"),
        (HeldDevice, DEVICE | {"hand_mass_kg": math.inf}, "hand_mass_kg"),
        (SendAll, {"gains": (((1.0,),),), "samples": 0}, "samples"),
        (SendAll, {"gains": (((1.0,),),), "ages": (1,), "sojourns": (1,)}, "sojourns"),
        (ColdStandbyRate, {"installed": 0, "rate": 1.0}, "installed"),
        (DelayChain, {"transition": [[1.0, 0.0], [math.nan, 1.0]]}, "transition[1]"),
        (HistoricalDesigned, {"memory": -1}, "memory"),
        (HistoricalDesigned, {"memory": 101}, "memory"),
        (HistoricalDesigned, {"window": 0}, "window"),
        (HistoricalDesigned, {"window": 11}, "window"),
        *((HistoricalDesigned, {"input_weight": value}, "input_weight") for value in (-1e-9, math.inf, math.nan)),
        *((HistoricalDesigned, {"start": "given", "peak_input": value}, "peak_input") for value in (0.0, math.inf, math.nan)),
        (HistoricalDesigned, {"peak_input": 1.0}, "peak_input"),
        (HistoricalDesigned, {"start": "given", "uses": "last-packets", "peak_input": 1.0}, "peak_input"),
        (HistoricalDesigned, {"start": "given", "peak_input": 1.0, "input_weight": 0.1}, "peak_input"),
        (chain, {"delays": [0, 1, 2]}, "delays"),
        (chain, {"delays": [0.0, 1.0]}, "delays"),
        (chain, {"delays": [0, -1]}, "delays"),
        (chain, {"labels": [0]}, "labels"),
        (chain, {"labels": [0, 0]}, "labels[0]"),
        (chain, {"between": (np.zeros((2, 3)), np.ones((2, 2)))}, "between"),
        (chain, {"between": (np.zeros((2, 2)), np.ones((2, 3)))}, "between"),
        (chain, {"between": (np.full((2, 2), 0.3), np.ones((2, 2)))}, "between"),
        (chain, {"between": (np.zeros((2, 2)), np.full((2, 2), 0.7))}, "between"),
        (chain, {"between": (np.zeros((2, 2)), np.full((2, 2), 1.1))}, "between"),
        (chain, {"between": (np.full((2, 2), -0.1), np.ones((2, 2)))}, "between"),
        (chain, {"stays": [0.1]}, "stays"),
        (chain, {"stays": [0.5, 0.76]}, "stays"),
        (chain, {"stays": [-0.1, 0.0]}, "stays"),
        (chain, {"ages": [0, 1]}, "ages"),
        (chain, {"ages": [[0, 0]]}, "ages"),
        (chain, {"ages": [[0.0], [1.0]]}, "ages"),
        (chain, {"ages": [[0, 0], [0, 0]]}, "ages"),
        (chain, {"ages": [[0, -1], [1, 0]]}, "ages"),
        (chain, {"held": [False]}, "held"),
        (chain, {"held": [0, 1]}, "held"),
        (chain, {"held": [[False], [True]]}, "held"),
        (chain, {"begins": [False, False]}, "begins"),
        (chain, {"begins": [0, 1]}, "begins"),
        (chain, {"begins": [True]}, "begins"),
    ],
)
def test_a_value_out_of_range_is_refused_with_its_field(make: Make, values: dict[str, Any], field: str) -> None:
    with pytest.raises(FieldError) as refused:
        make(**values)
    assert refused.value.field == field


@pytest.mark.parametrize(
    ("make", "values"),
    [
        (CouplerRequest, {"delays": (0, 3), "count": 0, "damping_n_s_per_m": 1e-9, "stiffness_n_per_m": 1e9, "equalise": True}),
        (CouplerRequest, {"varying": True, "count": 1}),
        (CouplerRequest, {"per_material": True, "method": "wave"}),
        (CouplerRequest, {"method": "taps", "taps_m_per_n": (0.1,)}),
        (Wall, {"material": 2, "chain_seed": 0, "chain": FAIR}),
        (Wall, {"chain": (FAIR[0], (0.0, 1.0, 0.0), (0.5, 0.5, 1e-10))}),
        (Wall, {"pattern": tiled(2), "materials": MATERIALS}),
        (HeldDevice, DEVICE),
        (ColdStandbyRate, {"installed": 1, "rate": 1.0}),
        (HistoricalDesigned, {"memory": 0, "window": 1, "input_weight": 0.0}),
        (HistoricalDesigned, {"memory": 100, "window": 10, "start": "given", "peak_input": 1e-9}),
        (chain, {"delays": [1, 1], "labels": [0, 0]}),
        (chain, {"labels": [0, 0], "held": [False, True]}),
        (chain, {"between": (P, P), "stays": [0.5, 0.75]}),
        (chain, {"between": (np.zeros((2, 2)), np.ones((2, 2))), "stays": [1.0, 0.0]}),
        (chain, {"ages": [[0, 0], [0, 1]], "held": [[False, True], [True, False]], "begins": [True, False]}),
        (chain, {"ages": [[0], [1]], "held": [False, True]}),
    ],
)
def test_a_value_at_the_edge_of_its_range_is_taken(make: Make, values: dict[str, Any]) -> None:
    made = make(**values)
    for name, value in values.items():
        assert np.array_equal(getattr(made, name), value) if make is chain else getattr(made, name) == value


@pytest.mark.parametrize(
    ("check", "fit", "refused"),
    [
        (check_finite, (-1.0, 0.0), (math.nan, -math.inf)),
        (check_above_zero, (5e-324, None), (0.0, -1.0, math.inf)),
        (check_at_least_zero, (0.0, 5e-324), (-5e-324, math.nan)),
    ],
)
def test_the_first_number_that_is_out_of_range_is_named(check: Make, fit: tuple[Any, ...], refused: tuple[float, ...]) -> None:
    check(**{f"field[{i}]": value for i, value in enumerate(fit)})
    for value in refused:
        with pytest.raises(FieldError, match=rf"^wrong: {value!r}, expected a finite number"):
            check(right=fit[0], wrong=value, worse=refused[0])
