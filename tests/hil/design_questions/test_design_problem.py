"""The models that a design begins with, beside the plants that they are of."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from hil.design_questions.design_problem import PRINTED_VTOL, problem_for, tracking_target
from hil.errors import HilError
from plants import VTOL


def test_the_printed_vtol_is_the_zero_order_hold_of_the_plant_to_four_decimals() -> None:
    model = VTOL().model()
    (n, m), T = model.B.shape, 0.01
    held = expm(T * np.block([[model.A, model.B], [np.zeros((m, n + m))]]))[:n]
    A, B, C = map(np.array, PRINTED_VTOL)
    assert np.abs(A - held[:, :n]).max() < 0.7e-4 and np.abs(B - held[:, n:]).max() < 0.7e-4 and np.array_equal(C, model.C)
    printed = tracking_target("vtol")
    assert np.array_equal(printed.A, A) and np.array_equal(printed.B, B) and printed.period_s == T
    assert np.allclose(tracking_target("vtol", T).A, held[:, :n], atol=1e-12)


def test_an_option_that_no_design_has_is_named_with_those_that_there_are() -> None:
    with pytest.raises(HilError, match=r"design: no option is called 'start'.*starts.*There are: "):
        problem_for(tracking_target("dc-motor"), start=3)
