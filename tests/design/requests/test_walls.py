"""Couplers as an experiment asks for them: of which delays, for which damping, with how many samples in a packet."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from msgspec import structs

from design.controllers import LoopModel
from design.controllers.rendered_wall import wave_coupler
from design.controllers.wall import Wall
from design.controllers.wall_pattern import square_rows
from design.errors import FieldError
from design.passivity import HeldDevice
from design.passivity.synthesis import stiffest_coupler
from design.passivity.transparency import sparing
from design.processes.delay_chain import DelayChain
from design.requests.tracking import DesignTask
from design.requests.walls import CouplerRequest, DesignedFollowing, DesignedWall

PERIOD_S, DAMPING = 0.001, 7.0
HALF = [[0.5, 0.5], [0.5, 0.5]]


def task(damping: float = DAMPING, **change: Any) -> DesignTask:
    A, B = HeldDevice(mass_kg=0.8, damping_n_s_per_m=damping).discretise(PERIOD_S)
    model = LoopModel(A=A, B=B[:, None], C=np.eye(3, 2), period_s=PERIOD_S, tau_max=3, d_max=2)
    chains = {"sc": DelayChain(transition=HALF, delays=[1, 2]), "ca": DelayChain(transition=HALF)}
    return DesignTask(**{"model": model} | chains | change)


def solved(loop: DesignTask | None = None, **asked: Any) -> Any:
    return DesignedWall(coupler=CouplerRequest(**asked)).solve(task() if loop is None else loop)


@pytest.mark.parametrize(
    ("asked", "change", "taps", "samples"),
    [
        ({}, {}, 4, 1),  # delays from 1 + 0 to 2 + 1
        ({}, {"sc": None}, 5, 1),  # up to 3 + 1
        ({}, {"ca": None}, 5, 1),
        ({"equalise": True}, {}, 6, 3),  # 3 + 2, and samples that are 1 to 3 slots old
        ({"equalise": True}, {"sc": None}, 6, 4),
        ({"equalise": True, "delays": (2,)}, {}, 3, 3),
        ({"delays": (4, 1)}, {}, 5, 1),
    ],
)
def test_a_coupler_is_for_the_delays_that_its_loop_can_have(
    asked: dict[str, Any], change: dict[str, Any], taps: int, samples: int
) -> None:
    found = solved(task(**change), method="wave", **asked)
    assert len(found.coupler.taps_m_per_n) == taps and found.samples == samples and found.equalise == ("equalise" in asked)
    assert found.coupler.taps_m_per_n[0] == pytest.approx(PERIOD_S / (2.0 * DAMPING), rel=1e-8)


def test_every_method_counts_on_the_damping_that_is_said_or_read_from_the_model() -> None:
    assert solved(method="theorem-6.1", damping_n_s_per_m=2.0).coupler == wave_coupler(PERIOD_S, 2.0, 0)
    given = {"period_s": PERIOD_S, "damping_n_s_per_m": 5.0}
    held = solved(damping_n_s_per_m=5.0, count=30).coupler
    moving = solved(damping_n_s_per_m=5.0, varying=True).coupler
    assert held == stiffest_coupler((1, 2, 3), taps=30, **given).coupler
    assert moving == stiffest_coupler((1, 2, 2, 3), varying=True, **given).coupler
    taps = solved(task(damping=0.0), method="taps", taps_m_per_n=(0.1, 0.2), integrator_m_per_n=0.3)
    assert (taps.coupler.taps_m_per_n, taps.coupler.integrator_m_per_n) == ((0.1, 0.2), 0.3)
    own = solved(method="wave", per_material=True)
    assert own.wall == replace(Wall(), materials=sparing(Wall().materials, own.coupler, PERIOD_S)) and own.wall.spares


@pytest.mark.parametrize(
    ("wall", "chain"),
    [(Wall(), np.eye(3)), (Wall(pattern=square_rows(0.02)), np.full((3, 3), 1 / 3)), (Wall(material=1), np.eye(3))],
)
def test_materials_that_nothing_is_said_of_stay_or_follow_each_other_alike(wall: Wall, chain: np.ndarray) -> None:
    said = DesignedFollowing(wall=wall, material_chain=tuple(map(tuple, chain.tolist())))
    assert DesignedFollowing(wall=wall).solve(task()) == said.solve(task())


@pytest.mark.parametrize(
    ("loop", "field"),
    [
        (task(damping=0.0), "coupler.damping_n_s_per_m"),
        (task(model=structs.replace(task().model, A=np.eye(3))), "wall"),
        (task(model=structs.replace(task().model, B=np.ones((2, 2)))), "wall"),
    ],
)
def test_a_plant_that_is_no_damped_device_is_refused(loop: DesignTask, field: str) -> None:
    with pytest.raises(FieldError) as caught:
        solved(loop)
    assert caught.value.field == field
