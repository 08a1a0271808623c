"""The axis at its samples against the matrix exponential, its derivatives against differences, the square wave."""

import numpy as np
import pytest
from scipy.linalg import expm

from design.errors import DesignError
from design.identification import Record, expected_errors, forced, free, held, sensitivities, square_wave


@pytest.mark.parametrize("pole", [-1.0, 0.0, 1e-9, 0.499, 0.501, 2.5, 60.0])
def test_one_sample_is_that_of_the_matrix_exponential(pole):
    step = held(pole, 1.0)
    exact = expm(np.array([[0.0, 1.0, 0.0], [0.0, -pole, 1.0], [0.0, 0.0, 0.0]]))
    assert [step.a, step.s1, step.s2] == pytest.approx([exact[1, 1], exact[0, 1], exact[0, 2]], rel=1e-12)


@pytest.mark.parametrize("pole", [-0.3, 0.0, 0.49, 2.5, 30.0])
def test_the_derivatives_are_those_of_differences(pole):
    rng = np.random.default_rng(1)
    record = Record(u=rng.standard_normal(60), y=np.zeros(60), period_s=0.05)
    gain, start, eps = 1.3, (0.2, -0.7), 1e-5

    def output(g, p, y0, v0):
        return y0 + v0 * free(60, p, 0.05)[0] + g * forced(record.u, p, 0.05)[0]

    jacobian = sensitivities([record], gain, pole, [start])
    at = np.array([gain, pole, *start])
    for i in range(4):
        step = np.eye(4)[i] * eps
        assert jacobian[:, i] == pytest.approx((output(*(at + step)) - output(*(at - step))) / (2 * eps), abs=1e-8)


def test_the_square_wave_of_section_6_2_1_has_22_samples_a_half_wave():
    wave = square_wave(88, 0.05, 0.4545, 0.02)
    assert np.flatnonzero(np.diff(wave)).tolist() == [21, 43, 65] and set(wave.tolist()) == {0.02, -0.02}
    with pytest.raises(DesignError, match="at most 10 Hz"):
        square_wave(10, 0.05, 21.0, 1.0)


def test_an_input_that_does_not_move_the_axis_is_refused():
    with pytest.raises(DesignError, match="does not move"):
        expected_errors(np.zeros(100), 0.05, 1.0, 1.0, 1e-3)
