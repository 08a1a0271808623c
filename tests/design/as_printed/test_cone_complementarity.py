"""The thesis's route to gains, on a scalar plant whose best gains are known from the direct descent."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from design.as_printed.cone_complementarity import design_by_ccl, solve_ccl
from design.errors import DesignError
from design.tracking import TrackingProblem
from design.tracking.synthesis import solve

ALWAYS, LATE = [[1.0]], [[0.6, 0.4], [0.5, 0.5]]


def problem(objective: str, *, ca: list[list[float]] = ALWAYS, sc: list[list[float]] = ALWAYS, **more: object) -> TrackingProblem:
    return TrackingProblem(A=[[0.9]], B=[[1.0]], C=[[1.0]], sc=sc, ca=ca, R=0.1, objective=objective, starts=1, **more)  # type: ignore[arg-type]


@pytest.mark.parametrize("objective", ["h2", "hinf"])
def test_the_route_falls_to_the_norm_that_the_descent_finds(objective: str) -> None:
    design = problem(objective, ca=LATE)
    said: list[tuple[str, int, int, float]] = []
    found = design_by_ccl(design, progress=lambda *each: said.append(each))  # type: ignore[arg-type]
    best = solve(design)
    norm, least = (getattr(each.certificate, f"{objective}_norm") for each in (found, best))
    assert least * (1.0 - 1e-6) <= norm < 1.001 * least and np.abs(found.gains - best.gains).max() < 0.02
    assert all(name == "ccl" and of == 60 for name, _, of, _ in said)
    assert [number for _, number, *_ in said] == list(range(1, len(said) + 1)) and 30 < len(said) <= 60
    levels = [level for *_, level in said]
    assert sorted(levels, reverse=True) == levels and levels[-1] == pytest.approx(norm, rel=1e-9)


@pytest.mark.parametrize("objective", ["h2", "hinf"])
def test_every_level_that_was_reached_is_in_the_history_and_is_that_of_gains(objective: str) -> None:
    """Ages of samples: from gains that stabilise, most of 10 programmes lower the level."""
    found = solve_ccl(problem(objective, sc=LATE), iterations=10)
    numbers, levels = zip(*found.history)
    assert numbers[0] == 0 and found.iterations == 10 and set(numbers) <= set(range(11))
    assert all(after < before for before, after in pairwise(levels)) and len(levels) > 5 and levels[-1] < 0.9 * levels[0]
    assert found.level == levels[-1] > getattr(solve(problem(objective, sc=LATE)).certificate, f"{objective}_norm")
    shorter = solve_ccl(problem(objective, sc=LATE), iterations=4)
    assert shorter.history == found.history[: len(shorter.history)] and shorter.iterations == 4


def test_a_bound_on_the_gains_and_two_norms_at_once_are_not_of_this_route() -> None:
    for options in ({"gain_bound": 1.0}, {"objective": "mixed", "hinf_bound": 5.0}):
        with pytest.raises(DesignError, match="ccl solves h2 and hinf problems without a gain bound"):
            solve_ccl(problem(**({"objective": "h2"} | options)))  # type: ignore[arg-type]
