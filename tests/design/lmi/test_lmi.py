"""A solve that fails, stops early or holds by rounding only is not the last word: the second opinion is asked, and checked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

import design.lmi as lmi
from design.lmi import as_fraction, decide, program, prove, prove_certificate, second_opinion
from design.lmi.program import Inequality, LmiProgram, symmetric_part

A = np.array([[0.0, 1.0], [-2.0, -0.5]])


def lyapunov(a: np.ndarray = A, *, diagonal: bool = False, bound: float = 50.0) -> LmiProgram:
    found = LmiProgram()
    n = len(a)
    if diagonal:
        found.add("P", np.stack([np.diag(row) for row in np.eye(n)]))
    else:
        found.symmetric("P", n)
    found.require("decrease", lambda p: symmetric_part(p @ a), "P")
    found.require("P >= I", lambda p: np.eye(n) - p, "P")
    found.require("bounded", lambda p: p - bound * np.eye(n), "P")
    return found


def stops_early(share: float) -> Any:
    """A Clarabel that returns a share of its solution, and no dual matrices, as after too few iterations."""
    sound = program.clarabel

    def stopped(q: np.ndarray, a: Any, b: np.ndarray, sizes: list[int]) -> tuple[np.ndarray, np.ndarray, str]:
        x, z, _ = sound(q, a, b, sizes)
        return share * x, np.zeros_like(z), "MaxIterations"

    return stopped


@pytest.mark.parametrize("diagonal", [False, True])
def test_a_solve_that_stops_early_is_taken_over_by_cvxpy(monkeypatch: pytest.MonkeyPatch, diagonal: bool) -> None:
    a = np.array([[-1.0, 0.4], [-0.3, -2.0]]) if diagonal else A
    monkeypatch.setattr(program, "clarabel", stops_early(0.01))
    alone = decide(lyapunov(a, diagonal=diagonal), verify_with="nothing")
    assert not alone.holds and not alone.refused and alone.solver == "clarabel"
    found = decide(lyapunov(a, diagonal=diagonal))
    P = found.matrices["P"]
    assert found.holds and found.solver == "cvxpy" and found.margin > 0.5
    assert np.linalg.eigvalsh(P @ a + a.T @ P).max() < 0 < np.linalg.eigvalsh(P).min()
    assert not diagonal or P[0, 1] == 0.0  # the pattern of the unknown is kept


def test_a_margin_as_small_as_rounding_is_asked_again(monkeypatch: pytest.MonkeyPatch) -> None:
    one = LmiProgram()
    one.symmetric("x", 1)
    one.require("x > 1", lambda x: 1.0 - x, "x")
    sound = program.clarabel

    def narrow(q: np.ndarray, a: Any, b: np.ndarray, sizes: list[int]) -> tuple[np.ndarray, np.ndarray, str]:
        _, z, status = sound(q, a, b, sizes)
        return np.array([1.0 + 1e-12, 1e-12]), np.zeros_like(z), status

    monkeypatch.setattr(program, "clarabel", narrow)
    assert decide(one, verify_with="nothing").holds
    assert decide(one).solver == "cvxpy" and decide(one).margin > 0.1


def test_without_doubt_nothing_is_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    def no_opinion(*_: object, **__: object) -> None:
        raise AssertionError("asked without a doubt")

    monkeypatch.setattr(lmi, "second_opinion", no_opinion)
    assert decide(lyapunov()).solver == "clarabel"  # holds
    hopeless = lyapunov(A + np.eye(2))
    hopeless.reach = 50.0
    assert decide(hopeless).refused


def test_the_second_opinion_is_not_believed_either(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a solution, what cvxpy returns does not verify, and the first answer stands."""
    monkeypatch.setattr(program, "clarabel", stops_early(0.01))
    found = decide(lyapunov(A + np.eye(2)))
    assert not found.holds and found.solver == "clarabel"


@dataclass(frozen=True, kw_only=True)
class Held:
    """A certificate that holds in floats by less than the rounding to fractions takes away."""

    matrices: Mapping[str, np.ndarray]
    method: str = "pwl"

    def rebuild(self, lift: Any) -> list[Inequality]:
        a, one = lift(A), lift(np.eye(2))
        return [
            Inequality(name="decrease", function=lambda p: symmetric_part(p @ a), on=("P",)),
            Inequality(name="P > I", function=lambda p: one - p, on=("P",)),
        ]


def test_a_proof_that_fails_narrowly_is_found_at_the_second_opinion() -> None:
    P = decide(lyapunov()).matrices["P"]
    P = P / np.linalg.eigvalsh(P).min() * (1.0 + 1e-12)  # P > I holds in floats, not after rounding to 2^-24
    narrow = Held(matrices={"P": P})
    assert np.linalg.eigvalsh(P).min() > 1.0 and not prove(narrow).proved
    proof = prove_certificate(narrow)
    assert proof.proved and proof.matrices_by == "cvxpy"
    sound = Held(matrices={"P": 2.0 * P})
    assert prove_certificate(sound).matrices_by == "certificate" and as_fraction(1.0) == 1


@pytest.mark.parametrize("seed", range(4))
def test_both_routes_reach_the_same_margin(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(3, 3))
    a -= (np.linalg.eigvals(a).real.max() + 0.3) * np.eye(3)
    program = lyapunov(a, bound=2.0)  # so that the best margin, at most 1/2, is one number, also where it is negative
    assert second_opinion(program).margin == pytest.approx(program.solve().margin, rel=1e-3)


def test_an_unstable_matrix_has_no_solution_for_either() -> None:
    program = lyapunov(np.array([[0.1, 1.0], [0.0, -1.0]]))
    ours = program.solve()
    assert not ours.holds and not second_opinion(program).holds


def test_full_unknowns_and_feedback_are_found_too() -> None:
    a, b = np.array([[0.0, 1.0], [2.0, -1.0]]), np.array([[0.0], [1.0]])
    program = LmiProgram()
    program.symmetric("X", 2)
    program.matrix("U", 1, 2)
    program.require("stable", lambda X, U: symmetric_part(a @ X + b @ U), "X", "U")
    program.require("X > I", lambda X: np.eye(2) - X, "X")
    program.require("X < 20", lambda X: X - 20 * np.eye(2), "X")
    theirs = second_opinion(program)
    K = theirs.matrices["U"] @ np.linalg.inv(theirs.matrices["X"])
    assert theirs.holds and np.linalg.eigvals(a + b @ K).real.max() < 0


def test_unknowns_that_are_not_square_come_with_their_basis() -> None:
    program = LmiProgram()
    program.matrix("U", 2, 3)
    a, b = np.diag([0.5, 0.5, -1.0]), np.eye(3, 2)
    program.require("stable", lambda U: symmetric_part(a + b @ U), "U")
    assert second_opinion(program).holds


def test_inequalities_that_exclude_each_other_have_no_matrices() -> None:
    program = LmiProgram()
    program.matrix("X", 1, 2)
    program.require("above 1", lambda X: 1.0 - X[..., :1], "X", strict=False)
    program.require("below 0", lambda X: X[..., :1], "X", strict=False)
    theirs = second_opinion(program)
    assert not theirs.holds and theirs.status == "infeasible"
    assert theirs.matrices["X"].shape == (1, 2) and np.isnan(theirs.matrices["X"]).all()
