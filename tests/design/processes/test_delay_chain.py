"""A chain of delays says what is wrong with its matrix."""

import numpy as np
import pytest

from design.errors import FieldError
from design.processes.delay_chain import check_transition


@pytest.mark.parametrize("matrix, shape", [([[1.0, 0.0]], r"\(1, 2\)"), ([1.0], r"\(1,\)"), (np.zeros((0, 0)), r"\(0, 0\)")])
def test_a_matrix_that_is_not_square_is_refused_with_its_shape(matrix, shape):
    with pytest.raises(FieldError, match=rf"^Pi: shape {shape}, expected a square matrix$"):
        check_transition(matrix, "Pi")
