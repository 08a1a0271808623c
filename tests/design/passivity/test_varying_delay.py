"""A delay that varies in any way: the condition, what it costs beside waiting, and that nothing is given away under it."""

import numpy as np
import pytest

from design.controllers.rendered_wall import Coupler, wave_coupler
from design.controllers.wall import Contact, Material, Wall
from design.passivity import HeldDevice
from design.passivity.certificate import certify_wall, keeps_order, lags
from design.passivity.condition import is_passive_over
from design.passivity.synthesis import stiffest_coupler
from design.processes.delay_chain import DelayChain

PERIOD_S, DAMPING = 0.001, 7.0
HARD = Wall(materials=(Material(stiffness_n_per_m=5e4), Material(stiffness_n_per_m=2e4)))
CHANCE = DelayChain(transition=np.full((2, 2), 0.5), delays=np.array([1, 2]))


def certify(coupler, sc=CHANCE, ca=1, **change):
    device = HeldDevice(mass_kg=0.8, damping_n_s_per_m=DAMPING)
    given = {"device": device, "wall": Wall(), "coupler": coupler, "period_s": PERIOD_S, "sc": sc, "ca": ca}
    return certify_wall(**{**given, **change})


def stiffest(delays, varying):
    return stiffest_coupler(delays, period_s=PERIOD_S, damping_n_s_per_m=DAMPING, varying=varying).coupler


def test_what_is_designed_for_the_change_is_certified_and_what_is_designed_for_each_delay_is_not():
    moving = certify(stiffest(lags([1, 2], [1]), varying=True))
    assert moving.certified and "in any order" in moving.reason and moving.number <= DAMPING
    held = certify(stiffest([2, 3], varying=False))
    assert held.state == "undecided" and "not for their change, which takes" in held.reason and held.number > DAMPING


def test_waiting_is_never_softer():
    moving, waiting = stiffest(lags([1, 2], [1]), varying=True), wave_coupler(PERIOD_S, DAMPING, 3)
    assert moving.static_compliance_m_per_n == pytest.approx(7 * PERIOD_S / (2 * DAMPING), rel=1e-5)
    assert waiting.static_compliance_m_per_n == pytest.approx(4 * PERIOD_S / (2 * DAMPING), rel=1e-9)
    assert certify(waiting, equalised=True).certified


def test_samples_out_of_their_order_are_not_covered():
    jumps = DelayChain(transition=np.full((2, 2), 0.5), delays=np.array([1, 3]))
    assert keeps_order(CHANCE) and keeps_order(2) and not keeps_order(jumps)
    coupler = stiffest(lags([1, 3], [1]), varying=True)
    verdict = certify(coupler, sc=jumps)
    assert verdict.state == "undecided" and "samples that come in their order" in verdict.reason
    assert certify(coupler, sc=1, ca=jumps).certified, "the force may be felt in any order"


def given(coupler: Coupler, seed: int, taus: tuple[int, ...], forces: tuple[int, ...]) -> float:
    """Largest energy in J that a motor has given beyond what damping takes, over delays that change at random."""
    rng = np.random.default_rng(seed)
    contact = Contact(HARD, PERIOD_S)
    A, b = HeldDevice(mass_kg=float(10 ** rng.uniform(-1.5, 0.5)), damping_n_s_per_m=DAMPING,
                      hand_stiffness_n_per_m=float(10 ** rng.uniform(1, 5))).discretise(PERIOD_S)  # fmt: skip
    state, x, forces_n = np.zeros(2), [0.0] * 8, [0.0] * 64
    energy, most, tau = 0.0, 0.0, taus[0]
    for k in range(4000):
        tau = int(rng.choice([t for t in taus if t <= tau + 1]))
        if k % 50 == 0:
            contact.change(int(rng.integers(2)))
        past = sum(c * f for c, f in zip(coupler.taps_m_per_n[1:], forces_n))
        forces_n = [contact.press(x[tau] - past, coupler.taps_m_per_n[0]), *forces_n[:-1]]
        felt = -forces_n[int(rng.choice(forces))]
        state = A @ state + b * (felt + 2.0 * rng.standard_normal() + 1.0)
        moved = float(state[0]) - x[0]
        energy += moved * (felt - DAMPING * moved / PERIOD_S)
        most, x = max(most, energy), [float(state[0]), *x[:-1]]
    return most


@pytest.mark.parametrize("seed", range(5))
def test_under_any_change_of_delay_damping_takes_what_the_motor_gives(seed):
    assert given(stiffest(lags([0, 1, 2], [0, 1]), varying=True), seed, (0, 1, 2), (0, 1)) < 1e-9


def test_a_coupler_for_no_delay_gives_energy_under_a_change():
    assert max(given(wave_coupler(PERIOD_S, DAMPING, 0), seed, (0, 1, 2), (0, 1)) for seed in range(5)) > 1e-4


def test_the_condition_is_the_sum_over_pairs():
    assert lags([1, 3], [0, 2]) == (1, 2, 3, 3, 4, 5)
    unit = PERIOD_S / (2 * DAMPING)
    each = [wave_coupler(PERIOD_S, DAMPING, d).taps_m_per_n for d in (2, 3)]
    both = Coupler(taps_m_per_n=tuple(a + b for a, b in zip((*each[0], 0.0), each[1])))
    assert is_passive_over(both, PERIOD_S, DAMPING, 2, 3)
    less = Coupler(taps_m_per_n=(both.taps_m_per_n[0] - 1e-3 * unit, *both.taps_m_per_n[1:]))
    assert not is_passive_over(less, PERIOD_S, DAMPING, 2, 3)
