"""Rows of probabilities, in whatever form a user writes them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from transport.errors import FieldError
from transport.laws.age import IidAge, MarkovAge
from transport.laws.stochastic_matrix import checked_numbers

ROWS = ((0.5, 0.5), (0.25, 0.75))


@pytest.mark.parametrize("form", [list, tuple, np.array, lambda rows: [np.array(row) for row in rows]])
def test_lists_tuples_and_arrays_say_the_same(form: Any) -> None:
    assert MarkovAge(matrix=form(ROWS)) == MarkovAge(matrix=ROWS)
    assert IidAge(probabilities=form(ROWS)[1]) == IidAge(probabilities=ROWS[1])


@pytest.mark.parametrize(("row", "size", "said"), [
    (np.array([[0.5], [0.5]]), None, r"m\[0\]: got \[0.5\], expected a number"), (np.array([]), None, "m: is empty"),
    (np.array([True, False]), None, r"m\[0\]: got True, expected a number"), ("0.5", None, "m: got '0.5', expected a list"),
    ({0.5, 0.25}, None, "m: got {.*}, expected a list"), ((0.5, 0.5), 3, "m: has 2 entries, expected 3"),
    (np.array(0.5), None, "m: got 0.5, expected a list"),
])  # fmt: skip
def test_what_is_no_row_of_numbers_is_refused(row: Any, size: int | None, said: str) -> None:
    with pytest.raises(FieldError, match=f"^{said}"):
        checked_numbers("m", row, size)
