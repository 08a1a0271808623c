"""The haptic joint, bare and held by a hand, and damping that changes over its workspace."""

from __future__ import annotations

import math

import numpy as np
import pytest

from plants.errors import FieldError
from plants.omni import DampingZone, Omni
from plants.parts.check import check_plant
from plants.parts.hand import Hand, Pace, Push, Slide
from plants.parts.protocols import HasPassiveElements


def test_a_torque_step_has_its_closed_form():
    """angle(t) = (t - (1 - e^(-at))/a)/b, a = b/m."""
    run = Omni().start(np.random.default_rng(0))
    a = 1.9857 / 0.7943
    for k in range(1, 101):
        run.advance(50_000_000, (1.0,))
        t = 0.05 * k
        assert run.measure()[0] == pytest.approx((t + math.expm1(-a * t) / a) / 1.9857, rel=1e-11)


HELD = Hand(
    mass_kg=0.5, damping_n_s_per_m=8.0, stiffness_n_per_m=60.0, reach_m=0.05, approach_s=0.333,
    push=Push(force_n=1.0, start_s=0.2, stop_s=0.5, tremor_n=0.15),
    slide=Slide(way="wander", speed_m_s=0.1, turn_s=0.07),
)  # fmt: skip

PACES = (Pace(speed_m_s=0.2, least_s=0.1, most_s=0.3), Pace(speed_m_s=0.05, least_s=0.2, most_s=0.2))


@pytest.mark.parametrize(
    "omni",
    [
        Omni(),
        Omni(encoder_noise_rad=1e-3),
        Omni(hand=Hand()),
        Omni(hand=HELD),
        Omni(hand=Hand(slide=Slide(heading_rad=0.3, paces=PACES))),
        Omni(hand=Hand(slide=Slide(way="lissajous")), coulomb_n=0.002, lever_m=0.135, encoder_step_m=1e-5, force_limit_n=0.005),
    ],
    ids=["bare", "noisy", "free", "held", "paced", "imperfect"],
)
def test_every_form_keeps_to_the_contract(omni):
    check_plant(omni)


def test_the_published_push_of_the_free_device():
    """1 N moves it 44.8 mm in 0.30 s and 58.8 mm in 0.35 s, before any controller can react."""
    run = Omni(hand=Hand(push=Push(force_n=1.0))).start(np.random.default_rng(0))
    run.advance(300_000_000, (0.0,))
    assert run.measure()[0] == pytest.approx(0.0448, abs=5e-5)
    run.advance(50_000_000, (0.0,))
    assert run.measure()[0] == pytest.approx(0.0588, abs=5e-5)


def test_the_lever_turns_the_printed_numbers_into_a_joint():
    """With r = 0.135 m the same numbers are m/r^2 and b/r^2 at the tip: b > K T/2 + |B| holds for every material (B0)."""
    joint = Omni(hand=Hand(), lever_m=0.135)
    assert joint.tip_mass_kg == pytest.approx(0.7943 / 0.135**2)
    assert all(joint.tip_damping_n_s_per_m > k * 0.05 / 2 + b for k, b in ((1000, 2), (800, 2), (800, 5)))
    assert not any(Omni(hand=Hand()).tip_damping_n_s_per_m > k * 0.05 / 2 + b for k, b in ((1000, 2), (800, 2), (800, 5)))


def test_a_hand_comes_to_rest_where_it_means_to_be():
    hand = Hand(mass_kg=0.5, damping_n_s_per_m=8.0, stiffness_n_per_m=60.0, reach_m=0.05)
    run = Omni(hand=hand).start(np.random.default_rng(0))
    for _ in range(200):
        run.advance(50_000_000, (0.0,))
    assert run.state[0] == pytest.approx(0.05, abs=1e-9) and run.state[1] == pytest.approx(0.0, abs=1e-9)


def test_the_observer_counts_what_is_given_beyond_damping():
    """A force that pushes gives; one that only brakes gives nothing."""
    run = Omni(hand=Hand()).start(np.random.default_rng(0))
    run.advance(50_000_000, (1.0,))
    moved = run.measure()[0]
    assert run.state[5] == pytest.approx(moved * (1.0 - 1.9857 * moved / 0.05), rel=1e-12)
    braking = Omni(hand=Hand(), initial_speed_rad_s=1.0).start(np.random.default_rng(0))
    braking.advance(50_000_000, (-1.0,))
    assert braking.state[5] == 0.0


def test_the_tremor_has_the_spread_and_the_memory_it_says():
    """40,000 samples 10 correlation times apart: sd within 2 % (4 sd of the estimate), correlation e^-1 after one within 0.03."""
    run = Omni(hand=Hand(push=Push(tremor_n=0.2, tremor_correlation_s=0.01, tremor_hold_s=0.01))).start(np.random.default_rng(5))
    forces = []
    for _ in range(40_000):
        run.advance(10_000_000, (0.0,))
        forces.append(run.state[4])
    x = np.array(forces)
    assert x.std() == pytest.approx(0.2, rel=0.03)
    assert np.corrcoef(x[:-1], x[1:])[0, 1] == pytest.approx(np.exp(-1), abs=0.03)


def test_encoder_limit_and_friction_do_what_they_say():
    run = Omni(hand=Hand(), encoder_step_m=0.001, force_limit_n=0.5).start(np.random.default_rng(0))
    run.advance(300_000_000, (2.0,))
    assert run.applied == (0.5,) and run.measure()[0] == pytest.approx(0.0224, abs=6e-4)
    assert run.measure()[0] / 0.001 == pytest.approx(round(run.measure()[0] / 0.001))
    stuck = Omni(hand=Hand(), coulomb_n=0.3).start(np.random.default_rng(0))
    stuck.advance(300_000_000, (0.29,))
    assert stuck.state[0] == 0.0
    assert Omni(hand=Hand(), encoder_step_m=0.001, coulomb_n=0.1).beyond_model() == ("dry friction", "an encoder that rounds")


def test_a_hand_that_changes_its_pace_stays_as_long_as_it_is_given():
    """Stays of 0.1 to 0.3 s at 0.2 m/s and of 0.2 s at 0.05 m/s: the mean speed follows, within 5 standard errors."""
    run = Omni(hand=Hand(slide=Slide(paces=PACES))).start(np.random.default_rng(1))
    y = [0.0]
    for _ in range(40_000):
        run.advance(10_000_000, (0.0,))
        y.append(run.state[2])
    speeds = np.diff(y) / 0.01
    slow, fast = np.isclose(speeds, 0.05), np.isclose(speeds, 0.2)
    assert (slow | fast).mean() > 0.85 and speeds.min() > 0.05 - 1e-9 and speeds.max() < 0.2 + 1e-9
    change = np.flatnonzero(np.diff(fast.astype(int)))
    stays = np.diff(change) * 0.01
    assert stays.max() < 0.33 and stays.min() > 0.07
    assert y[-1] / 400.0 == pytest.approx((0.2 * 0.2 + 0.05 * 0.2) / 0.4, abs=5 * 0.15 * 0.058 / 0.4 / np.sqrt(1000))


def test_paces_are_checked_by_name():
    for change in ({"paces": PACES[:1]}, {"paces": PACES, "way": "wander"}, {"paces": PACES, "speed_m_s": 0.1}):
        with pytest.raises(ValueError, match=r"^paces: "):
            Slide(**change)
    with pytest.raises(ValueError, match=r"^most_s: 0\.1, expected a finite number, at least least_s"):
        Pace(speed_m_s=0.1, least_s=0.2, most_s=0.1)


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
