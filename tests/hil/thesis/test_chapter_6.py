"""Chapter 6: verdicts with the numbers that they rest on, and verdicts that turn with them."""

import pytest
from scipy.stats import chi2

from design.as_printed.chapters_5_and_6 import (
    LAMBDA,
    PERIOD_S,
    energy_of_a_press,
    least_real_part,
    meets_printed_condition,
    printed_distortion,
    theorem_61_coupler,
)
from design.controllers.rendered_wall import wave_coupler
from design.controllers.wall import MATERIALS
from design.jump_linear.bounded_real import hinf_norm
from design.passivity import HeldDevice, push_response
from design.passivity.transparency import distortion
from hil.thesis.chapter6 import PASSIVITY, PUSH, passivity, push
from hil.thesis.chapter6_equations import EQUATIONS, equations, loop_of
from hil.thesis.chapter6_wall import wall
from hil.thesis.statements import judge

DEVICE = HeldDevice(mass_kg=0.7943, damping_n_s_per_m=1.9857)


def test_a_verdict_turns_with_its_number():
    """Whether the device needs a coupler hangs on where the printed units are read; with far more damping it never does."""
    verdicts = []
    for damping in (0.01, 1.9857, 1.9857 / 0.135**2):
        rows = judge(PASSIVITY, passivity(HeldDevice(mass_kg=0.7943, damping_n_s_per_m=damping)))
        verdicts += [row.verdict for row in rows if row.item.startswith("6.3: without a coupler")]
    assert verdicts == ["reproduced", "undecided", "not reproduced"]


def test_the_materials_are_told_apart_at_the_joint_and_not_at_the_tip():
    """1/(1/K_i + 1/ceiling): 1000 and 800 N/m, and 18.225 and 14.58 N m/rad, behind 2 b/(7 T)."""
    ceiling = 2 * 1.9857 / (7 * PERIOD_S)
    stiff = [[1 / (1 / (K * scale) + 1 / ceiling) for K in (1000.0, 800.0)] for scale in (1.0, 0.135**2)]
    numbers = equations()
    assert numbers["felt"] == pytest.approx([1 - soft / hard for hard, soft in stiff], rel=1e-9)
    row = next(r for r in judge(EQUATIONS, numbers) if "it is clear that" in r.item)
    assert [check.holds for check in row.checks] == [False, True] and row.verdict == "undecided"


def test_the_printed_statements_and_their_counterexamples():
    assert meets_printed_condition(theorem_61_coupler(1.9857), 1.9857)
    assert least_real_part(DEVICE, 0) == pytest.approx(0.0006, abs=2e-4)
    assert [least_real_part(DEVICE, n) for n in (1, 2, 6)] == pytest.approx([-0.50, -0.40, -0.49], abs=0.01)
    assert energy_of_a_press("plain") == pytest.approx(-0.91, abs=0.2)
    assert energy_of_a_press("energy") > -1e-9
    assert PERIOD_S == 0.05


@pytest.mark.parametrize(("cutoff", "norm"), [(0.3, 845.1), (3.0, 1718.6)])
def test_the_printed_weighted_system_is_driven_by_nothing(cutoff, norm):
    wave = wave_coupler(PERIOD_S, DEVICE.damping_n_s_per_m, 6)
    meant = distortion(MATERIALS, LAMBDA, wave, period_s=PERIOD_S, delay=6, cutoff_hz=cutoff)
    assert hinf_norm(meant) == pytest.approx(norm, rel=1e-3)
    assert hinf_norm(printed_distortion(MATERIALS, LAMBDA, wave, cutoff_hz=cutoff)) == 0.0


def test_the_device_moves_at_once():
    late = next(r for r in judge(PUSH, push()) if "the delays of the responses" in r.item)
    assert late.verdict == "claim false" and late.witness[0].value > 1.0  # mm after one sample


def test_figure_6_8_is_drawn_in_millimetres_of_the_depths_that_are_judged():
    numbers = push()
    materials, couplers = (panel.series for panel in numbers["figures"][0].panels)
    final = [numbers["final"] - numbers["deeper"], numbers["final"], numbers["final"]]
    assert [curve.y[-1] for curve in materials] == pytest.approx(final, rel=4e-4)  # not at rest yet
    assert materials[0].y[1] == pytest.approx(numbers["start"], rel=1e-12) and materials[0].x[1] == PERIOD_S
    for curve, coupler in zip(couplers, (wave_coupler(PERIOD_S, 1.9857, 6), theorem_61_coupler(1.9857))):
        depth_m = push_response(loop_of(coupler), MATERIALS[0], 6, 0, 1.0, len(curve.x) - 1)
        assert curve.y == pytest.approx(depth_m / 1e-3, rel=1e-12) and curve.x[-1] == pytest.approx(PERIOD_S * (len(curve.x) - 1))


def test_that_the_material_has_a_memory_takes_ten_times_what_chance_gives():
    numbers = wall()
    assert numbers["limit"] == pytest.approx(float(chi2.isf(1e-3, numbers["freedom"])))
    assert numbers["far"] == 10.0 * numbers["limit"]
