"""Bounds under norm-bounded uncertainty hold for sampled uncertainties, and collapse to the norms without any."""

import numpy as np
import pytest

from design.errors import Infeasible
from design.jump_linear import h2_norm
from design.jump_linear.bounded_real import hinf_norm
from design.networked_loop.closed_loop import loop_structure
from design.networked_loop.uncertainty import robust_norms, uncertainty_margin
from design.tracking import TrackingProblem
from tests.design.chapter7 import LAMBDA, MOTOR, PI, PRINTED_HINF

# the motor's time constant and gain known to about 10 %: the input matrix and the speed's row move together
M, N1, N2 = np.array([[0.02], [0.5]]), np.array([[0.0, 0.04]]), np.array([[0.7]])


def structure(A=MOTOR[0], B=MOTOR[1]):
    return loop_structure(A, B, MOTOR[2], LAMBDA, PI, "generated")


def short(A=MOTOR[0], B=MOTOR[1]):
    """The motor over the actuator's network alone: two modes, and a search that takes a second."""
    return loop_structure(A, B, MOTOR[2], [[1.0]], PI, "generated")


SHORT_GAINS = PRINTED_HINF[:1]


def with_delta(delta, loop=structure, gains=PRINTED_HINF):
    change = M @ delta @ np.hstack([N1, N2])
    return loop(MOTOR[0] + change[:, :2], MOTOR[1] + change[:, 2:]).system(gains)


def test_margin_is_sound_and_nearly_reached_by_a_constant_uncertainty():
    margin = uncertainty_margin(structure(), PRINTED_HINF, M, N1, N2)
    assert margin > 1
    for delta in (-margin, margin):
        assert with_delta(np.array([[0.999 * delta]])).radius() < 1
    assert max(with_delta(np.array([[2.0 * d]])).radius() for d in (-margin, margin)) > 1


def test_guaranteed_norms_bound_those_of_sampled_plants():
    bounds = robust_norms(short(), SHORT_GAINS, M, N1, N2)
    nominal = short().system(SHORT_GAINS)
    worst_h2, worst_hinf = h2_norm(nominal), hinf_norm(nominal)
    for delta in np.linspace(-1, 1, 9):
        plant = with_delta(np.array([[delta]]), short, SHORT_GAINS)
        worst_h2, worst_hinf = max(worst_h2, h2_norm(plant)), max(worst_hinf, hinf_norm(plant))
    assert worst_h2 < bounds.h2 < 2 * worst_h2
    assert worst_hinf < bounds.hinf < 2 * worst_hinf


@pytest.mark.parametrize("reference_weight", [0.0, 3.0])
def test_vanishing_uncertainty_leaves_the_nominal_norms(reference_weight):
    asked = TrackingProblem(A=MOTOR[0], B=MOTOR[1], C=MOTOR[2], sc=[[1.0]], ca=PI, information="generated",
                            reference_weight=reference_weight)  # fmt: skip
    loop = asked.structure()
    nominal = loop.system(SHORT_GAINS)
    bounds = robust_norms(loop, SHORT_GAINS, 1e-4 * M, N1, N2)
    assert uncertainty_margin(loop, SHORT_GAINS, M, N1, N2) == uncertainty_margin(short(), SHORT_GAINS, M, N1, N2)
    assert np.isclose(bounds.h2, h2_norm(nominal), rtol=1e-3)
    assert np.isclose(bounds.hinf, hinf_norm(nominal), rtol=1e-3)


@pytest.mark.parametrize("scale", [1e-14, 1e14])
def test_the_same_uncertainty_in_other_units_has_the_same_norms(scale):
    bounds = robust_norms(short(), SHORT_GAINS, M, N1, N2)
    same = robust_norms(short(), SHORT_GAINS, M / scale, scale * N1, scale * N2)
    assert (same.h2, same.hinf) == pytest.approx((bounds.h2, bounds.hinf), rel=1e-5)


def test_too_much_uncertainty_is_refused_with_the_margin():
    with pytest.raises(Infeasible, match=r"bears .Delta. up to 0") as caught:
        robust_norms(structure(), PRINTED_HINF, 50 * M, N1, N2)
    assert 0 < caught.value.value < 1


@pytest.mark.parametrize(
    "change, message",
    [
        ({"M": np.ones((3, 1))}, "M: shape"),
        ({"N1": np.ones((1, 3))}, "N1: shape"),
        ({"N2": np.ones((2, 1))}, "N2: 2 rows, expected 1"),
    ],
)
def test_wrong_shapes_are_refused_by_name(change, message):
    with pytest.raises(ValueError, match="^" + message):
        uncertainty_margin(structure(), PRINTED_HINF, **({"M": M, "N1": N1, "N2": N2} | change))
