"""The stiffest coupler: what it reaches, what nothing can exceed, and that a request above it is refused with the number."""

import numpy as np
import pytest

from design.controllers.rendered_wall import wave_coupler
from design.controllers.wall import MATERIALS
from design.errors import DesignError, Infeasible
from design.passivity import HapticLoop, push_response
from design.passivity.condition import is_passive_over
from design.passivity.synthesis import ceiling_n_per_m, least_sum, stiffest_coupler
from tests.design.passivity.published import DAMPING, DEVICE, LAMBDA, PERIOD_S


@pytest.fixture(scope="module")
def designed():
    return stiffest_coupler(range(9), period_s=PERIOD_S, damping_n_s_per_m=DAMPING)


def test_delays_up_to_eight_reach_the_published_bar(designed):
    """C(1) <= 0.1345 m/N, second-moment radius <= 0.958 with no hand under the published chain."""
    assert designed.coupler.static_compliance_m_per_n <= 0.1345
    loop = HapticLoop(device=DEVICE, coupler=designed.coupler, period_s=PERIOD_S, sc_max=3, ca_max=3)
    assert loop.jump_system(MATERIALS, LAMBDA, 3, 3).radius() <= 0.958


def test_it_is_within_one_percent_of_what_any_causal_coupler_can_reach(designed):
    assert designed.bound_m_per_n <= designed.coupler.static_compliance_m_per_n <= 1.01 * designed.bound_m_per_n


@pytest.mark.parametrize("delays", [(0,), (3,), (6,), (5, 6, 7), (0, 4), tuple(range(9))])
def test_every_delay_of_the_set_meets_the_condition_exactly(delays):
    found = stiffest_coupler(delays, period_s=PERIOD_S, damping_n_s_per_m=DAMPING)
    assert all(is_passive_over(found.coupler, PERIOD_S, DAMPING, nd) for nd in delays)
    assert found.stiffness_n_per_m <= ceiling_n_per_m(PERIOD_S, DAMPING, max(delays)) * (1 + 1e-12)


@pytest.mark.parametrize("delay", [0, 1, 6])
def test_one_delay_reaches_the_ceiling_as_the_wave_coupler_does(delay):
    found = stiffest_coupler([delay], period_s=PERIOD_S, damping_n_s_per_m=DAMPING)
    wave = wave_coupler(PERIOD_S, DAMPING, delay)
    assert found.coupler.static_compliance_m_per_n == pytest.approx(wave.static_compliance_m_per_n, rel=1e-5)
    assert 1 / wave.static_compliance_m_per_n == pytest.approx(ceiling_n_per_m(PERIOD_S, DAMPING, delay), rel=1e-12)
    assert least_sum([delay]) == pytest.approx(delay + 1, rel=1e-9)


def test_a_hand_with_damping_ten_is_pressed_to_23_mm():
    found = stiffest_coupler(range(9), period_s=PERIOD_S, damping_n_s_per_m=DAMPING + 10.0)
    loop = HapticLoop(device=DEVICE, coupler=found.coupler, period_s=PERIOD_S, sc_max=3, ca_max=3)
    depth = [push_response(loop, m, 3, 3, 1.0, 4000)[-1] for m in MATERIALS]
    assert 1 / 1000 + found.coupler.static_compliance_m_per_n <= 0.0233
    held = HapticLoop(
        device=DEVICE.__class__(mass_kg=DEVICE.mass_kg, damping_n_s_per_m=DAMPING, hand_damping_n_s_per_m=10.0),
        coupler=found.coupler, period_s=PERIOD_S, sc_max=3, ca_max=3,
    )  # fmt: skip
    depth = [push_response(held, m, 3, 3, 1.0, 4000)[-1] for m in MATERIALS]
    assert depth[0] <= 0.0233
    assert depth[1] == pytest.approx(depth[2], abs=1e-9)
    assert depth[1] - depth[0] == pytest.approx(0.25e-3, abs=1e-9)


def test_materials_two_and_three_end_a_quarter_of_a_millimetre_deeper(designed):
    loop = HapticLoop(device=DEVICE, coupler=designed.coupler, period_s=PERIOD_S, sc_max=3, ca_max=3)
    depth = [push_response(loop, m, 3, 3, 1.0, 2400)[-1] for m in MATERIALS]
    assert depth[0] == pytest.approx(1e-3 + designed.coupler.static_compliance_m_per_n, abs=1e-8)
    assert depth[2] == pytest.approx(depth[1], abs=1e-8)
    assert depth[1] - depth[0] == pytest.approx(0.25e-3, abs=1e-8)


def test_the_shape_depends_on_the_delays_alone(designed):
    other = stiffest_coupler(range(9), period_s=0.001, damping_n_s_per_m=7.0)
    ratio = np.asarray(other.coupler.taps_m_per_n) / np.asarray(designed.coupler.taps_m_per_n)
    assert ratio == pytest.approx(np.full(ratio.size, 0.001 / 7.0 / (PERIOD_S / DAMPING)), rel=1e-12)


def test_a_request_above_the_ceiling_is_refused_with_the_ceiling():
    with pytest.raises(Infeasible, match=r"above the ceiling .* = 11\.3469 N/m") as caught:
        stiffest_coupler([6], period_s=PERIOD_S, damping_n_s_per_m=DAMPING, stiffness_n_per_m=12.0)
    assert caught.value.value == pytest.approx(11.3469, abs=1e-4)


def test_a_request_between_the_reach_of_the_set_and_the_ceiling_is_refused_with_the_reach(designed):
    ceiling = ceiling_n_per_m(PERIOD_S, DAMPING, 8)
    assert designed.stiffness_n_per_m < 8.0 < ceiling
    with pytest.raises(Infeasible, match=r"reaches 7\.47") as caught:
        stiffest_coupler(range(9), period_s=PERIOD_S, damping_n_s_per_m=DAMPING, stiffness_n_per_m=8.0)
    assert caught.value.value == pytest.approx(designed.stiffness_n_per_m)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"delays": []}, "delays: "),
        ({"delays": [-1, 2]}, "delays: "),
        ({"period_s": 0.0}, "period_s: "),
        ({"damping_n_s_per_m": 0.0}, "damping_n_s_per_m: "),
        ({"taps": 6}, "taps: 6, expected 7"),
        ({"taps": 4000}, "taps: 4000"),
    ],
)
def test_arguments_out_of_range_are_refused_by_name(change, message):
    given = {"delays": [6], "period_s": PERIOD_S, "damping_n_s_per_m": DAMPING, **change}
    with pytest.raises(DesignError, match=f"^{message}"):
        stiffest_coupler(given.pop("delays"), **given)
