"""Nodes along the sojourn: where sections start, where rates have a kink, where they settle, and parts of each gap."""

from __future__ import annotations

import numpy as np
import pytest

from design.errors import FieldError
from design.processes.rates import PiecewiseLinearRate, constant_rate
from design.processes.semi_markov import SemiMarkov
from design.semi_markov_loop.sojourn_grid import refine

RATE = PiecewiseLinearRate(times_s=(0.0, 2.0, 6.0), values=(1.0, 3.0, 2.0))
KINKED = SemiMarkov(rates=((None, RATE), (constant_rate(1.0), None)))


@pytest.mark.parametrize(("parts", "steps"), [(1, [0.0, 1.0, 2.0, 6.0]), (2, [0.0, 0.5, 1.0, 1.5, 2.0, 4.0, 6.0])])
def test_every_gap_between_starts_kinks_and_the_end_is_cut_into_as_many_parts(parts: int, steps: list[float]) -> None:
    first, second = refine(KINKED, ((0.0, 1.0), (0.0,)), parts)
    assert np.allclose(first, steps) and second == (0.0,)


def test_no_part_is_refused() -> None:
    with pytest.raises(FieldError, match="parts: 0, expected at least 1"):
        refine(KINKED, ((0.0,), (0.0,)), 0)
