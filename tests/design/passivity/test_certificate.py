"""What is claimed of a haptic loop, and that nothing is claimed where the theory does not know."""

from dataclasses import replace

import numpy as np
import pytest

from design.controllers.rendered_wall import Coupler, wave_coupler
from design.controllers.wall import Contact, Material, Wall
from design.controllers.wall_pattern import Patch, Pattern, square_rows
from design.passivity import HeldDevice
from design.passivity.certificate import certify_wall
from design.passivity.synthesis import stiffest_coupler
from design.processes.delay_chain import DelayChain
from tests.design.passivity.published import DAMPING, DEVICE, LAMBDA, PERIOD_S

DESIGNED = stiffest_coupler(range(9), period_s=PERIOD_S, damping_n_s_per_m=DAMPING).coupler
MIXED, CHANGING = Wall(pattern=square_rows(0.02)), Wall(chain=tuple(map(tuple, LAMBDA.tolist())))
RANDOM = DelayChain(transition=np.array([[0.5, 0.5], [0.5, 0.5]]), delays=np.array([2, 3]))


def certify(**change):
    loop = {"device": DEVICE, "wall": MIXED, "coupler": DESIGNED, "period_s": PERIOD_S, "sc": 3, "ca": 3}
    return certify_wall(**{**loop, **change})


def test_the_designed_coupler_is_certified_over_the_published_delays():
    verdict = certify()
    assert verdict.certified and verdict.kind == "passivity"
    assert verdict.number <= verdict.limit == DAMPING
    assert certify(wall=CHANGING).details["mean_square_radius"] < 0.958 and "mean_square_radius" not in verdict.details
    assert verdict.details["delays"] == [6]


def test_theorem_61_is_refused_with_its_spectral_radius():
    verdict = certify(coupler=wave_coupler(PERIOD_S, DAMPING, 0))
    assert verdict.state == "refused"
    assert verdict.number == pytest.approx(1.153, abs=5e-4) and verdict.limit == 1.0


@pytest.mark.parametrize("gain", [0.0005, 0.001, 0.0025, 0.005, 0.01, 0.02])
def test_an_integrator_lets_a_free_device_rest_anywhere_and_is_passive(gain):
    """It adds d/T to the condition's real part, and a radius of 1 but for rounding, above or below."""
    verdict = certify(coupler=Coupler(taps_m_per_n=DESIGNED.taps_m_per_n, integrator_m_per_n=gain))
    assert verdict.certified and verdict.details["stable"] is False, verdict.reason
    assert verdict.details["spectral_radius"] == pytest.approx(1.0, abs=1e-12)


def test_a_wave_coupler_is_certified_for_its_delay_and_refused_one_sample_later():
    wave = wave_coupler(PERIOD_S, DAMPING, 6)
    assert certify(coupler=wave).certified
    assert certify(coupler=wave, ca=4).state == "refused"


def test_a_coupler_that_is_stable_but_misses_the_condition_is_undecided_with_the_damping_it_needs():
    wave = wave_coupler(PERIOD_S, DAMPING, 6)
    verdict = certify(coupler=Coupler(taps_m_per_n=tuple(0.999 * c for c in wave.taps_m_per_n)))
    assert verdict.state == "undecided"
    assert verdict.number == pytest.approx(DAMPING / 0.999, rel=1e-6) and verdict.number > verdict.limit


def test_a_delay_that_varies_is_undecided_and_equalised_it_is_certified():
    verdict = certify(wall=CHANGING, sc=RANDOM)
    assert verdict.state == "undecided" and "varies" in verdict.reason
    assert verdict.details["mean_square_radius"] < 1.0
    assert certify(sc=RANDOM, equalised=True).certified


def test_a_second_moment_that_grows_is_refused():
    verdict = certify(wall=replace(CHANGING, switching="plain"), coupler=wave_coupler(PERIOD_S, DAMPING, 0), sc=RANDOM)
    assert verdict.state == "refused" and verdict.number > 1.0


def test_plain_switching_between_two_stiffnesses_is_undecided():
    assert certify(wall=Wall(switching="plain", pattern=MIXED.pattern)).state == "undecided"
    one_stiffness = Wall(materials=Wall().materials[1:], switching="plain", chain=((0.5, 0.5), (0.5, 0.5)))
    assert certify(wall=one_stiffness).certified


def test_damping_of_the_hand_is_counted_and_named():
    held = HeldDevice(mass_kg=DEVICE.mass_kg, damping_n_s_per_m=DAMPING, hand_damping_n_s_per_m=10.0)
    coupler = stiffest_coupler(range(9), period_s=PERIOD_S, damping_n_s_per_m=DAMPING + 10.0).coupler
    assert certify(device=held, coupler=coupler).certified
    assert any("11.9857" in text for text in certify(device=held, coupler=coupler).assumptions)
    assert not certify(coupler=coupler).certified


def test_no_damping_at_all_is_not_certified():
    assert not certify(device=HeldDevice(mass_kg=1.0, damping_n_s_per_m=0.0)).certified


SOFT_AND_HARD = (Material(stiffness_n_per_m=22.0), Material(stiffness_n_per_m=2140.0))
IN_TURNS = ((0.0, 1.0), (1.0, 0.0))
HELD = HeldDevice(mass_kg=0.5, damping_n_s_per_m=8.0, hand_stiffness_n_per_m=60.0)
EIGHT = stiffest_coupler(range(3), period_s=PERIOD_S, damping_n_s_per_m=8.0).coupler
HALF = Coupler(taps_m_per_n=tuple(0.5 * tap for tap in EIGHT.taps_m_per_n))


def settles(wall: Wall, sc: int) -> bool:
    """Whether the held device comes to rest under a constant push, its position late by sc and its force by 1."""
    A, B = HELD.discretise(PERIOD_S)
    contact, x, seen, forces = Contact(wall, PERIOD_S, 0), np.zeros(2), [0.0] * 9, [0.0] * 20
    places = []
    for k in range(1500):
        contact.change(k % 2)
        seen = [float(x[0]), *seen[:-1]]
        past = sum(tap * f for tap, f in zip(HALF.taps_m_per_n[1:], forces))
        forces = [contact.press(seen[sc] - past, HALF.taps_m_per_n[0]), *forces[:-1]]
        x = A @ x + B * (5.0 - forces[1])
        places.append(float(x[0]))
    return float(np.std(places[-300::2])) < 1e-6


@pytest.mark.parametrize("sc", [1, DelayChain(transition=[[0.5, 0.5], [0.5, 0.5]], delays=[0, 1])])
def test_contacts_that_never_last_and_surfaces_that_move_refuse_nothing(sc):
    """A hard material that is there for a slot at a time does not throw the hand off, where the energy rule moves its surface."""
    wall = {rule: Wall(materials=SOFT_AND_HARD, switching=rule, chain=IN_TURNS) for rule in ("energy", "plain")}
    found = {rule: certify(device=HELD, coupler=HALF, sc=sc, ca=1, wall=own) for rule, own in wall.items()}
    assert found["energy"].state == "undecided" and "misses the condition" in found["energy"].reason
    assert found["plain"].state == "refused" and found["plain"].number > 1.0
    assert [settles(wall["energy"], late) for late in (0, 1)] == [True, True] and not settles(wall["plain"], 1)
    stays = Wall(materials=SOFT_AND_HARD, chain=((0.5, 0.5), (0.001, 0.999)))
    assert certify(device=HELD, coupler=HALF, sc=sc, ca=1, wall=stays).state == "refused"


def test_a_material_that_is_never_met_decides_nothing():
    for never, there in (
        ({"chain": ((1.0, 0.0), (0.001, 0.999))}, {"chain": ((0.5, 0.5), (0.0, 1.0))}),
        ({"pattern": square(0)}, {"pattern": square(1)}),
    ):
        walls = [Wall(materials=SOFT_AND_HARD, **which) for which in (never, there)]
        found = [certify(device=HELD, coupler=HALF, sc=1, ca=1, wall=wall) for wall in walls]
        assert [verdict.state for verdict in found] == ["undecided", "refused"]


def square(material):
    return Pattern(width_m=1.0, height_m=1.0, patches=(Patch(y_m=0.0, z_m=0.0, width_m=1.0, height_m=1.0, material=material),))
