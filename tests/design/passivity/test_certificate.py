"""What is claimed of a haptic loop, and that nothing is claimed where the theory does not know."""

import numpy as np
import pytest

from design.controllers.rendered_wall import Coupler, wave_coupler
from design.controllers.wall import Wall
from design.controllers.wall_pattern import square_rows
from design.passivity.certificate import certify_wall
from design.passivity.loop import HeldDevice
from design.passivity.synthesis import stiffest_coupler
from design.processes.delay_chain import DelayChain
from tests.design.passivity.published import DAMPING, DEVICE, LAMBDA, PERIOD_S

DESIGNED = stiffest_coupler(range(9), period_s=PERIOD_S, damping_n_s_per_m=DAMPING).coupler
MIXED = Wall(pattern=square_rows(0.02))
RANDOM = DelayChain(transition=np.array([[0.5, 0.5], [0.5, 0.5]]), delays=np.array([2, 3]))


def certify(**change):
    loop = {"device": DEVICE, "wall": MIXED, "coupler": DESIGNED, "period_s": PERIOD_S, "sc": 3, "ca": 3}
    return certify_wall(**{**loop, "material_chain": LAMBDA, **change})


def test_the_designed_coupler_is_certified_over_the_published_delays():
    verdict = certify()
    assert verdict.certified and verdict.kind == "passivity"
    assert verdict.number <= verdict.limit == DAMPING
    assert verdict.details["mean_square_radius"] < 0.958
    assert verdict.details["delays"] == [6]


def test_theorem_61_is_refused_with_its_spectral_radius():
    verdict = certify(coupler=wave_coupler(PERIOD_S, DAMPING, 0))
    assert verdict.state == "refused"
    assert verdict.number == pytest.approx(1.153, abs=5e-4) and verdict.limit == 1.0


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
    verdict = certify(sc=RANDOM)
    assert verdict.state == "undecided" and "varies" in verdict.reason
    assert verdict.details["mean_square_radius"] < 1.0
    assert certify(sc=RANDOM, equalised=True).certified


def test_a_second_moment_that_grows_is_refused():
    verdict = certify(coupler=wave_coupler(PERIOD_S, DAMPING, 0), sc=RANDOM)
    assert verdict.state == "refused" and verdict.number > 1.0


def test_plain_switching_between_two_stiffnesses_is_undecided():
    assert certify(wall=Wall(switching="plain", pattern=MIXED.pattern)).state == "undecided"
    one_stiffness = Wall(materials=Wall().materials[1:], switching="plain", chain=((0.5, 0.5), (0.5, 0.5)))
    assert certify(wall=one_stiffness, material_chain=one_stiffness.chain).certified


def test_a_delay_without_a_chain_is_undecided():
    assert certify(sc=None).state == "undecided"


def test_damping_of_the_hand_is_counted_and_named():
    held = HeldDevice(mass_kg=DEVICE.mass_kg, damping_n_s_per_m=DAMPING, hand_damping_n_s_per_m=10.0)
    coupler = stiffest_coupler(range(9), period_s=PERIOD_S, damping_n_s_per_m=DAMPING + 10.0).coupler
    assert certify(device=held, coupler=coupler).certified
    assert any("11.9857" in text for text in certify(device=held, coupler=coupler).assumptions)
    assert not certify(coupler=coupler).certified


def test_no_damping_at_all_is_not_certified():
    assert not certify(device=HeldDevice(mass_kg=1.0, damping_n_s_per_m=0.0)).certified
