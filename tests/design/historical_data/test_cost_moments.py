"""Mean and variance of the cost over the paths of a random schedule."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from design.errors import NotStable
from design.historical_data import LiftedLoop, cycle
from design.historical_data.cost_bounds import cost_moments

L = np.array([[[0.3, 0.2, 0.0], [1.0, 0.0, 0.1], [0.0, -0.3, 0.2]], [[-0.2, 0.1, 0.3], [0.2, 0.4, 0.0], [0.1, 0.0, -0.5]]])
Q = np.array([np.diag([1.0, 0.5, 0.0]), np.array([[1.0, 0.2, 0.0], [0.2, 2.0, 0.0], [0.0, 0.0, 0.3]])])
P, FIRST, X0 = np.array([[0.7, 0.3], [0.4, 0.6]]), np.array([0.25, 0.75]), np.array([1.0, -2.0])


def by_enumeration(loop: LiftedLoop, depth: int) -> tuple[float, float]:
    """Mean and variance over all 2^depth paths of the sum up to that slot."""
    first = second = 0.0
    for path in product(range(2), repeat=depth):
        share, x, total = FIRST[path[0]], np.array([*X0, 0.0]), 0.0
        for i, j in zip(path, (*path[1:], None)):
            total += x @ loop.Q[i] @ x
            x = loop.L[i] @ x
            share *= 1.0 if j is None else loop.transition[i, j]
        first, second = first + share * total, second + share * total**2
    return first, second - first**2


def test_they_are_those_of_all_paths() -> None:
    loop = LiftedLoop(L=0.7 * L, Q=Q, transition=P)
    found, reported = cost_moments(loop, X0, FIRST), by_enumeration(loop, 12)
    assert found == pytest.approx(reported, rel=1e-6) and found.variance > 0.01 * found.mean**2


def test_a_cycle_from_one_phase_has_no_variance_and_from_two_that_of_the_draw() -> None:
    loop = LiftedLoop(L=0.7 * L, Q=Q, transition=cycle(2))
    sure = [cost_moments(loop, X0, np.eye(2)[i]) for i in (0, 1)]
    assert all(each.variance <= 1e-20 * each.mean**2 for each in sure)
    drawn = cost_moments(loop, X0, FIRST)
    assert drawn.variance == pytest.approx(FIRST.prod() * (sure[0].mean - sure[1].mean) ** 2, rel=1e-9)


def test_chance_that_comes_after_slots_without_any_counts() -> None:
    """The first two slots are sure: the variance is that from where they lead to."""
    later = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.5, 0.2, 0.3]])
    loop = LiftedLoop(L=0.6 * L[[0, 1, 0]], Q=Q[[0, 1, 0]], transition=later)
    found = cost_moments(loop, X0, np.array([1.0, 0.0, 0.0])).variance
    third = 0.6 * L[1] @ (0.6 * L[0] @ [*X0, 0.0])  # the state in slot 2
    assert found == pytest.approx(cost_moments(loop, third, np.array([0.0, 0.0, 1.0])).variance, rel=1e-9) and found > 0.0


def test_a_cost_may_have_a_mean_and_no_variance() -> None:
    """x grows by 1.4 with probability 1/2 and is 0 after that: E x^2 falls by 0.98 a slot, E x^4 grows by 1.92."""
    both = LiftedLoop(L=np.array([[[1.4]], [[0.0]]]), Q=np.ones((2, 1, 1)), transition=np.full((2, 2), 0.5))
    assert both.radius() < 1.0
    with pytest.raises(NotStable, match="fourth moment"):
        cost_moments(both, [1.0], np.array([0.5, 0.5]))
