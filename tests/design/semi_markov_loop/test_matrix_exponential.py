"""exp of stacks agrees with scipy's to rounding."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from design.semi_markov_loop.second_moments import exponential


@pytest.mark.parametrize("size", [1, 2, 4, 6])
def test_stack_agrees_with_scipy(size: int) -> None:
    rng = np.random.default_rng(size)
    stack = rng.standard_normal((20, size, size)) * np.geomspace(1e-3, 10, 20)[:, None, None]
    ours, theirs = exponential(stack), expm(stack)
    error = np.linalg.norm(ours - theirs, axis=(1, 2)) / np.linalg.norm(theirs, axis=(1, 2))
    assert error.max() < 1e-12
    assert exponential(np.zeros((3, size, size))) == pytest.approx(np.stack([np.eye(size)] * 3))
