"""A coupler per material: what it may count on, that it stays passive over changes of material, and what it gains."""

from dataclasses import replace

import numpy as np
import pytest

from design.controllers.rendered_wall import Coupler, static_coupler, wave_coupler
from design.controllers.virtual_wall import VirtualWall
from design.controllers.wall import MATERIALS, Contact, Material, Wall
from design.controllers.wall_pattern import square_rows
from design.errors import FieldError
from design.passivity import HapticLoop, HeldDevice, push_response
from design.passivity.certificate import certify_wall
from design.passivity.transparency import felt_n_per_m, sparing
from hil.compose import compose
from hil.experiment import load_experiment

SPRING = Material(stiffness_n_per_m=500.0)


@pytest.mark.parametrize("limit", [None, 15.0])
@pytest.mark.parametrize("period", [0.001, 0.05])
@pytest.mark.parametrize("seed", range(4))
def test_a_material_that_spares_the_coupler_what_it_gives_stays_passive(seed, period, limit):
    """sum f dx' >= S(now) - S(start) at the port x' = x_v - s f, under random movement and random changes of material."""
    rng = np.random.default_rng(seed)
    materials = tuple(
        replace(m, spared_m_per_n=float(rng.choice([0.0, 0.5, 0.999999])) * m.most_spared_m_per_n(period))
        for m in (*MATERIALS, SPRING)
    )
    contact = Contact(Wall(materials=materials, force_limit_n=limit), period)
    for k in range(3000):
        held, before = contact.energy_j, contact.port_m
        assert held >= -1e-12
        if k % 3 == 0:
            contact.change(int(rng.integers(4)))
            assert contact.port_m == pytest.approx(before, abs=1e-12)
        force = contact.press(float(rng.normal(0.01, 0.02)), 0.0013)
        assert force * (contact.port_m - before) >= contact.energy_j - held - 1e-10


def test_a_coupler_that_jumps_under_pressure_gives_energy_away():
    """One stiffness, two couplers; pressed behind the compliant one and released behind the other."""

    def absorbed(switching):
        lean = replace(SPRING, spared_m_per_n=0.9 / SPRING.stiffness_n_per_m)
        contact, total = Contact(Wall(materials=(SPRING, lean), switching=switching), 0.001), 0.0
        for i, x in enumerate([*np.linspace(0, 0.1, 200), *np.linspace(0.1, 0, 200)]):
            before = contact.port_m
            contact.change(int(i >= 200))
            total += contact.press(float(x), 0.002) * (contact.port_m - before)
        return total

    assert absorbed("plain") < -0.1
    assert absorbed("energy") > -1e-9


def certified(*, share=1.0, **change):
    period, damping, delay = 0.001, 7.0, 1
    coupler = wave_coupler(period, damping, delay)
    materials = tuple(replace(m, spared_m_per_n=share * m.most_spared_m_per_n(period)) for m in MATERIALS)
    wall = replace(Wall(materials=materials, pattern=square_rows(0.02)), **change)
    device = HeldDevice(mass_kg=9.97, damping_n_s_per_m=damping, hand_stiffness_n_per_m=4551.7)
    return certify_wall(device=device, wall=wall, coupler=coupler, period_s=period, sc=delay, ca=0)


def test_a_coupler_that_counts_on_more_than_the_material_gives_is_not_certified():
    """Up to 1/(K + 2 B/T) it is; 3 % beyond, a spring in the hand makes the contact unstable."""
    assert certified(share=0.999999).certified
    beyond = certified(share=1.03)
    assert beyond.state == "refused" and beyond.number > 1.0
    materials = tuple(replace(m, spared_m_per_n=1.03 * m.most_spared_m_per_n(0.001)) for m in MATERIALS)
    verdict = certify_wall(
        device=HeldDevice(mass_kg=0.8, damping_n_s_per_m=7.0), wall=Wall(materials=materials), period_s=0.001, sc=1, ca=0,
        coupler=static_coupler(0.002),
    )  # fmt: skip
    assert verdict.state == "undecided" and "wall.materials[0].spared_m_per_n" in verdict.reason
    assert certified(share=0.5, switching="plain").state == "undecided"


@pytest.mark.parametrize("seed", range(3))
def test_no_passive_hand_makes_a_certified_coupler_per_material_unstable(seed):
    rng = np.random.default_rng(seed)
    period, damping, delay = 0.001, 7.0, int(rng.integers(0, 5))
    coupler = wave_coupler(period, damping, delay)
    for material in sparing((*MATERIALS, SPRING), coupler, period):
        for _ in range(40):
            hand = HeldDevice(
                mass_kg=10 ** rng.uniform(-2, 1), damping_n_s_per_m=damping, hand_stiffness_n_per_m=10 ** rng.uniform(0, 6)
            )
            loop = HapticLoop(device=hand, coupler=coupler, period_s=period, sc_max=delay, ca_max=0)
            assert loop.radius(material, delay, 0) <= 1.0 + 1e-9


def test_the_shipped_experiment_is_felt_stiffer_than_with_one_coupler():
    one, own = (compose(load_experiment(name)) for name in ("omni-1khz", "omni-materials"))
    assert own.verdict.certified and one.verdict.certified
    before, after = (np.array(loop.verdict.details["felt_n_per_m"]) for loop in (one, own))
    assert (after > 1.05 * before).all() and (after <= [m.stiffness_n_per_m for m in MATERIALS]).all()
    assert own.controller.coupler == one.controller.coupler


def test_what_gives_way_to_no_constant_force_feels_rigid():
    assert felt_n_per_m(Material(stiffness_n_per_m=1000.0), Coupler(taps_m_per_n=(0.001, -0.002))) == np.inf


def test_a_constant_force_is_felt_as_said():
    device = HeldDevice(mass_kg=0.8, damping_n_s_per_m=7.0)
    coupler = wave_coupler(0.001, 7.0, 4)
    for material in sparing(MATERIALS, coupler, 0.001):
        loop = HapticLoop(device=device, coupler=coupler, period_s=0.001, sc_max=4, ca_max=0)
        depth = push_response(loop, material, 4, 0, 1.0, 8000)[-1]
        assert depth == pytest.approx(1.0 / felt_n_per_m(material, coupler), rel=1e-3)


def test_a_material_is_never_felt_stiffer_than_it_is():
    coupler = wave_coupler(0.001, 100.0, 0)
    assert coupler.static_compliance_m_per_n < MATERIALS[0].most_spared_m_per_n(0.001)
    for before, after in zip(MATERIALS, sparing(MATERIALS, coupler, 0.001)):
        assert felt_n_per_m(after, coupler) <= before.stiffness_n_per_m * (1.0 + 1e-12)


def test_bad_values_are_refused_by_name():
    with pytest.raises(FieldError, match=r"^spared_m_per_n: -0\.001, expected at least 0"):
        Material(stiffness_n_per_m=1000.0, spared_m_per_n=-1e-3)
    with pytest.raises(FieldError, match=r"^spared_m_per_n: 0\.001, expected at least 0 and less than 1/K"):
        Material(stiffness_n_per_m=1000.0, spared_m_per_n=1e-3)
    model = compose(load_experiment("omni-1khz")).model
    stiff = Wall(materials=(Material(stiffness_n_per_m=1000.0, damping_n_s_per_m=2.0, spared_m_per_n=9e-4),))
    with pytest.raises(FieldError, match=r"^wall\.materials\[0\]\.spared_m_per_n: 0\.0009; the force of .* no one value"):
        VirtualWall(wall=stiff, coupler=wave_coupler(0.001, 7.0, 0)).start(model)
