"""The second opinion agrees where the answer is known, and does not believe its solver either."""

from __future__ import annotations

import numpy as np
import pytest

from design.lmi.decision import second_opinion
from design.lmi.program import LmiProgram, symmetric_part


def lyapunov(a: np.ndarray, bound: float = 50.0) -> LmiProgram:
    n = len(a)
    program = LmiProgram()
    program.symmetric("P", n)
    program.require("Lyapunov", lambda P: symmetric_part(P @ a), "P")
    program.require("P > I", lambda P: np.eye(n) - P, "P")
    program.require("P < bound", lambda P: P - bound * np.eye(n), "P")
    return program


@pytest.mark.parametrize("seed", range(4))
def test_both_routes_reach_the_same_margin(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(3, 3))
    a -= (np.linalg.eigvals(a).real.max() + 0.3) * np.eye(3)
    program = lyapunov(a)
    ours = program.solve(largest_margin=1e6)  # beyond what P < 50 I allows, so that the best margin is one number
    theirs = second_opinion(program.inequalities, ours.matrices, largest_margin=1e6)
    assert ours.holds and theirs.holds
    assert theirs.margin == pytest.approx(ours.margin, rel=1e-3)


def test_an_unstable_matrix_has_no_solution_for_either() -> None:
    program = lyapunov(np.array([[0.1, 1.0], [0.0, -1.0]]))
    ours = program.solve()
    assert not ours.holds and not second_opinion(program.inequalities, ours.matrices).holds


def test_full_unknowns_and_feedback_are_found_too() -> None:
    a, b = np.array([[0.0, 1.0], [2.0, -1.0]]), np.array([[0.0], [1.0]])
    program = LmiProgram()
    program.symmetric("X", 2)
    program.matrix("U", 1, 2)
    program.require("stable", lambda X, U: symmetric_part(a @ X + b @ U), "X", "U")
    program.require("X > I", lambda X: np.eye(2) - X, "X")
    program.require("X < 20", lambda X: X - 20 * np.eye(2), "X")
    theirs = second_opinion(program.inequalities, {"X": np.eye(2), "U": np.zeros((1, 2))})
    K = theirs.matrices["U"] @ np.linalg.inv(theirs.matrices["X"])
    assert theirs.holds and np.linalg.eigvals(a + b @ K).real.max() < 0


def test_unknowns_that_are_not_square_come_with_their_basis() -> None:
    program = LmiProgram()
    program.matrix("U", 2, 3)
    a, b = np.diag([0.5, 0.5, -1.0]), np.eye(3, 2)
    program.require("stable", lambda U: symmetric_part(a + b @ U), "U")
    bases = {name: variable.basis for name, variable in program.variables.items()}
    assert second_opinion(program.inequalities, {"U": np.zeros((2, 3))}, bases=bases).holds


def test_inequalities_that_exclude_each_other_have_no_matrices() -> None:
    program = LmiProgram()
    program.matrix("X", 1, 2)
    program.require("above 1", lambda X: 1.0 - X[..., :1], "X", strict=False)
    program.require("below 0", lambda X: X[..., :1], "X", strict=False)
    theirs = second_opinion(program.inequalities, {"X": np.zeros((1, 2))})
    assert not theirs.holds and theirs.status == "infeasible"
    assert theirs.matrices["X"].shape == (1, 2) and np.isnan(theirs.matrices["X"]).all()
