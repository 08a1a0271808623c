"""The printed conditions of Chapter 6, each beside what shows that nothing follows from it."""

import numpy as np
import pytest

from design.as_printed.chapters_5_and_6 import DELAY, LAMBDA, inner_loop, meets_printed_attenuation, meets_printed_condition
from design.controllers.rendered_wall import static_coupler, wave_coupler
from design.controllers.wall import MATERIALS
from design.errors import FieldError
from design.jump_linear.bounded_real import hinf_norm
from design.passivity import HapticLoop
from design.passivity.transparency import distortion
from tests.design.passivity.published import DAMPING, DEVICE, PERIOD_S

WAVE = wave_coupler(PERIOD_S, DAMPING, DELAY)


def test_6_9_holds_and_the_loop_is_unstable_at_one_sample():
    coupler = wave_coupler(PERIOD_S, DAMPING, 0)
    assert meets_printed_condition(coupler, DAMPING)
    loop = HapticLoop(device=DEVICE, coupler=coupler, period_s=PERIOD_S, sc_max=1, ca_max=0)
    assert loop.radius(MATERIALS[0], 1, 0) == pytest.approx(1.083, abs=1e-3)
    assert not meets_printed_condition(static_coupler(0.9 * PERIOD_S / (2.0 * DAMPING)), DAMPING)


def test_6_12_finds_no_wall_more_transparent_than_a_safe_one():
    def norm(cutoff_hz: float) -> float:
        return hinf_norm(distortion(MATERIALS[:1], [[1.0]], WAVE, period_s=PERIOD_S, delay=DELAY, cutoff_hz=cutoff_hz))

    wall_off = MATERIALS[0].stiffness_n_per_m
    assert norm(3.0) == pytest.approx(2092, rel=1e-3) and norm(3.0) > wall_off
    assert norm(0.3) < wall_off  # 988.8 < 1000: it turns with the weight


def test_6_17_certifies_a_ten_thousandth_of_the_true_norm():
    """The norm under Lambda is 845.1 N/m; as printed nothing drives the weight, and any level is certified."""
    level = 0.06
    assert meets_printed_attenuation(MATERIALS, LAMBDA, WAVE, cutoff_hz=0.3, gamma=level)
    meant = hinf_norm(distortion(MATERIALS, LAMBDA, WAVE, period_s=PERIOD_S, delay=DELAY, cutoff_hz=0.3))
    assert meant == pytest.approx(845.1, abs=0.1)
    assert meant > 10_000 * level


def test_6_17_refuses_a_system_that_is_not_stable():
    unstable = static_coupler(-0.0011)
    assert np.abs(np.linalg.eigvals(inner_loop(MATERIALS[2], unstable, 0.3)[0])).max() > 1.0
    assert not meets_printed_attenuation(MATERIALS, LAMBDA, unstable, cutoff_hz=0.3, gamma=1e6)
    with pytest.raises(FieldError, match="gamma"):
        meets_printed_attenuation(MATERIALS, LAMBDA, WAVE, cutoff_hz=0.3, gamma=0.0)


def test_the_inner_loop_of_6_14_renders_the_wall_behind_its_coupler():
    """The force that leaves it, without delay, is G/(1 + G C): by its frequency response."""
    A, B, _ = inner_loop(MATERIALS[0], WAVE, 0.3)
    rate, direct = MATERIALS[0].damping_n_s_per_m / PERIOD_S, WAVE.taps_m_per_n[0]
    stiff = MATERIALS[0].stiffness_n_per_m + rate
    out = np.zeros(len(A))
    out[1] = -rate / (1.0 + stiff * direct)
    out[2:-1] = -stiff / (1.0 + stiff * direct) * np.asarray(WAVE.taps_m_per_n[1:])
    for t in (0.1, 1.0, 3.0):
        z = np.exp(1j * t)
        c = sum(tap * z**-l for l, tap in enumerate(WAVE.taps_m_per_n))
        g = MATERIALS[0].stiffness_n_per_m + rate * (1 - 1 / z)
        found = out @ np.linalg.solve(z * np.eye(len(A)) - A, B[:, 0]) + stiff / (1.0 + stiff * direct)
        assert found == pytest.approx(g / (1 + g * c), rel=1e-9)
