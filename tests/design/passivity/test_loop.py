"""The loop in contact as matrices: against a simulation of the wall itself, the published limits, the printed (6.12)."""

import numpy as np
import pytest

from design.controllers.rendered_wall import Coupler, static_coupler, wave_coupler
from design.controllers.wall import MATERIALS, Contact, Wall
from design.jump_linear.bounded_real import hinf_norm
from design.passivity import HapticLoop, HeldDevice, push_response
from design.passivity.stiffness_map import colgate_n_per_m, exact_n_per_m, gil_hulin_n_per_m
from design.passivity.synthesis import stiffest_coupler
from design.passivity.transparency import distortion, distortion_bound
from design.processes.delay_chain import DelayChain
from tests.design.passivity.published import DAMPING, DEVICE, LAMBDA, PERIOD_S


@pytest.mark.parametrize(("sc", "ca"), [(0, 0), (1, 0), (0, 2), (3, 3)])
@pytest.mark.parametrize("integrator", [0.0, 0.001])
def test_the_matrices_are_those_of_the_wall_that_runs(sc, ca, integrator):
    taps = stiffest_coupler(range(9), period_s=PERIOD_S, damping_n_s_per_m=DAMPING).coupler.taps_m_per_n
    coupler = Coupler(taps_m_per_n=taps, integrator_m_per_n=integrator)
    loop = HapticLoop(device=DEVICE, coupler=coupler, period_s=PERIOD_S, sc_max=3, ca_max=3)
    expected = push_response(loop, MATERIALS[2], sc, ca, 1.0, 60)
    A, b = DEVICE.discretise(PERIOD_S)
    contact = Contact(Wall(), PERIOD_S, material=2)
    state, seen, forces = np.zeros(2), [0.0] * 4, [0.0] * 24
    summed = 0.0
    for k in range(61):
        assert state[0] == pytest.approx(expected[k], abs=1e-12)
        seen = [float(state[0]), *seen[:-1]]
        past = sum(c * f for c, f in zip(coupler.taps_m_per_n[1:], forces)) + integrator * summed
        force = contact.press(seen[sc] - past, coupler.taps_m_per_n[0] + integrator)
        summed += force
        forces = [force, *forces[:-1]]
        state = A @ state + b * (1.0 - forces[ca])


def test_only_the_sum_of_both_delays_matters_to_the_eigenvalues():
    loop = HapticLoop(device=DEVICE, coupler=wave_coupler(PERIOD_S, DAMPING, 4), period_s=PERIOD_S, sc_max=6, ca_max=6)
    radii = [loop.radius(MATERIALS[0], sc, 4 - sc) for sc in range(5)]
    assert radii == pytest.approx([radii[0]] * 5, abs=1e-9)


@pytest.mark.parametrize(
    ("coupler", "radius"),
    [
        (static_coupler(PERIOD_S / (2 * DAMPING)), 1.32613),
        (wave_coupler(PERIOD_S, DAMPING, 6), 0.99944),
        (stiffest_coupler((5, 6, 7), period_s=PERIOD_S, damping_n_s_per_m=DAMPING).coupler, 0.9760),
    ],
    ids=["Theorem 6.1", "wave", "set"],
)
def test_second_moments_under_the_published_chain(coupler, radius):
    loop = HapticLoop(device=DEVICE, coupler=coupler, period_s=PERIOD_S, sc_max=3, ca_max=3)
    assert loop.jump_system(MATERIALS, LAMBDA, 3, 3).radius() == pytest.approx(radius, abs=1e-4)


def test_random_delays_are_a_jump_linear_system_too():
    """Delays 2 and 3 of the position, uniform: the radius lies near that of either alone, and 18 modes are counted."""
    coupler = stiffest_coupler(range(9), period_s=PERIOD_S, damping_n_s_per_m=DAMPING).coupler
    loop = HapticLoop(device=DEVICE, coupler=coupler, period_s=PERIOD_S, sc_max=3, ca_max=3)
    chain = DelayChain(transition=np.full((2, 2), 0.5), delays=np.array([2, 3]))
    system = loop.jump_system(MATERIALS, LAMBDA, chain, 3)
    assert system.modes == 6
    fixed = [loop.jump_system(MATERIALS, LAMBDA, d, 3).radius() for d in (2, 3)]
    assert min(fixed) - 0.02 < system.radius() < max(fixed) + 0.02
    same = DelayChain(transition=np.eye(1), delays=np.array([3]), labels=np.array([3]))
    assert loop.jump_system(MATERIALS, LAMBDA, same, 3).radius() == pytest.approx(fixed[1], rel=1e-9)


@pytest.mark.parametrize(
    ("delay", "slow", "fast"),
    [
        (0, (81.12, 144.6), (3973, 7955)),
        (1, (27.36, 48.0), (1325, 2652)),
        (2, (16.69, 28.3), (795, 1590)),
        (6, (6.81, 10.1), (306, 611)),
    ],
)
def test_limits_without_a_coupler(delay, slow, fast):
    """Stiffest stable walls of the loop itself (Section 6.4), at B = 0 and 2 N s/m."""
    for period, expected in ((PERIOD_S, slow), (0.001, fast)):
        found = [exact_n_per_m(DEVICE, period, delay, damping) for damping in (0.0, 2.0)]
        assert found == pytest.approx(expected, rel=4e-3)


def test_the_fields_anchors():
    assert colgate_n_per_m(PERIOD_S, DAMPING) == pytest.approx(79.43, abs=0.01)
    assert all(colgate_n_per_m(T, DAMPING, m.damping_n_s_per_m) < 0 for m in MATERIALS for T in (0.05, 1e-6))  # for every T
    assert gil_hulin_n_per_m(PERIOD_S, DAMPING, 6) == pytest.approx(6.11, abs=0.01)
    fine = exact_n_per_m(DEVICE, 1e-4, 3)
    assert fine == pytest.approx(gil_hulin_n_per_m(1e-4, DAMPING, 3), rel=1e-3)  # the linear boundary, as T -> 0


def test_a_hand_without_damping_or_device_damping_leaves_nothing():
    loose = HeldDevice(mass_kg=1.0, damping_n_s_per_m=0.0)
    assert exact_n_per_m(loose, PERIOD_S, 2) == 0.0


@pytest.mark.parametrize(("cutoff", "norm", "bound"), [(0.3, 845.1, 312.4), (1.0, 853.9, 672.5)])
def test_distortion_is_exact_and_no_coupler_beats_its_bound(cutoff, norm, bound):
    """(6.12) of the wave coupler; printed (6.17) without W driven would give 0.06."""
    coupler = wave_coupler(PERIOD_S, DAMPING, 6)
    exact = hinf_norm(distortion(MATERIALS, LAMBDA, coupler, period_s=PERIOD_S, delay=6, cutoff_hz=cutoff))
    assert exact == pytest.approx(norm, abs=0.1)
    single = hinf_norm(distortion(MATERIALS[:1], [[1.0]], coupler, period_s=PERIOD_S, delay=6, cutoff_hz=cutoff))
    assert single == pytest.approx(988.8, abs=0.1)
    low = distortion_bound(MATERIALS[0], period_s=PERIOD_S, delay=6, cutoff_hz=cutoff)
    assert low == pytest.approx(bound, abs=0.1)
    assert low < single


def test_the_distortion_is_the_transfer_function_on_the_circle():
    coupler = Coupler(taps_m_per_n=(0.02, 0.01, 0.003))
    system = distortion(MATERIALS[:1], [[1.0]], coupler, period_s=PERIOD_S, delay=2, cutoff_hz=1.0)
    A, B, C, _, _ = (m[0] for m in system.matrices)
    a = np.exp(-2 * np.pi * PERIOD_S)
    for angle in (0.2, 1.0, 2.7):
        z = np.exp(1j * angle)
        G = 1000.0 + 2.0 * (z - 1) / (PERIOD_S * z)
        T = G / (1 + G * (0.02 + 0.01 / z + 0.003 / z**2))
        expected = (1 - a) / (z - a) * (G - z**-2 * T)
        assert (C @ np.linalg.solve(z * np.eye(A.shape[0]) - A, B))[0, 0] == pytest.approx(expected, rel=1e-9)
