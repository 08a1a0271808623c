"""Damping that changes over the workspace of a held device."""

import numpy as np
import pytest

from plants.errors import FieldError
from plants.omni import DampingZone, Omni
from plants.parts.check import check_plant
from plants.parts.hand import Hand, Push
from plants.parts.protocols import HasPassiveElements

ZONES = (DampingZone(from_m=0.02, damping=4.0), DampingZone(from_m=0.05, damping=1.0))
PUSHED = Hand(push=Push(force_n=1.0))


def test_it_keeps_to_the_contract_however_time_is_cut():
    check_plant(Omni(hand=Hand(push=Push(force_n=1.0, tremor_n=0.2)), zones=ZONES))


def test_each_zone_has_its_own_final_speed():
    """v = F/b: a constant force ends each zone at the speed of its damping."""
    for zone, damping in ((10.0, 1.9857), (-10.0, 4.0)):
        run = Omni(hand=PUSHED, zones=(DampingZone(from_m=zone, damping=4.0),)).start(np.random.default_rng(0))
        for _ in range(400):
            run.advance(50_000_000, (0.0,))
        assert run.state[1] == pytest.approx(1.0 / damping, rel=1e-9)


def test_it_is_slower_behind_the_place_where_damping_rises():
    def path(zones):
        run = Omni(hand=PUSHED, zones=zones).start(np.random.default_rng(0))
        found = []
        for _ in range(500):
            run.advance(1_000_000, (0.0,))
            found.append(run.state[0])
        return np.array(found)

    free, slowed = path(()), path(ZONES[:1])
    before = free < 0.02
    assert np.array_equal(free[before], slowed[before]) and (slowed[~before][2:] < free[~before][2:]).all()


def test_the_model_has_the_least_damping_and_the_rest_is_passive():
    omni = Omni(hand=PUSHED, zones=ZONES)
    assert omni.model().A[1, 1] == -1.0 / omni.inertia
    assert "damping that changes over the workspace" in omni.beyond_model() and isinstance(omni, HasPassiveElements)
    assert [e.name for e in omni.passive_elements()] == ["damping that changes over the workspace"]
    assert Omni(hand=PUSHED, encoder_step_m=1e-5).passive_elements() == ()


def test_bad_zones_are_refused_by_name():
    with pytest.raises(FieldError, match=r"^zones\[1\]\.from_m: 0\.02, expected more than 0\.05"):
        Omni(hand=PUSHED, zones=ZONES[::-1])
    with pytest.raises(FieldError, match=r"^zones: belongs to the held device"):
        Omni(zones=ZONES)
    with pytest.raises(FieldError, match=r"^damping: -1"):
        DampingZone(from_m=0.0, damping=-1.0)
