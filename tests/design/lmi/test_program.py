"""The inequality layer: coefficients by probing, verdicts from matrices, proofs of absence, and exact arithmetic."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse

from design.lmi import as_fraction, at_gamma, decide, pivots, prove_inequalities, rounded, smallest_gamma, with_gamma
from design.lmi.program import Inequality, LmiProgram, excluded, largest_eigenvalue, symmetric_blocks, symmetric_part, verify

A = np.array([[0.0, 1.0], [-2.0, -0.5]])


def lyapunov(a: np.ndarray, bound: float = 100.0) -> LmiProgram:
    program = LmiProgram(reach=bound)
    program.symmetric("P", 2)
    program.require("decrease", lambda p: symmetric_part(p @ a), "P")
    program.require("P >= I", lambda p: np.eye(2) - p, "P", strict=False)
    program.require("bounded", lambda p: p - bound * np.eye(2), "P", strict=False)
    return program


def test_dual_matrices_that_are_no_numbers_exclude_nothing() -> None:
    """-x >= 1 and x >= 1 exclude each other; the dual matrices 1 and 1 say so, and no others."""
    q, a, b = np.zeros(1), sparse.csc_matrix(np.array([[1.0], [-1.0]])), np.array([-1.0, -1.0])
    assert excluded(q, a, b, [1, 1], np.array([1.0, 1.0])) > 1e100
    for z in ([1.0, np.nan], [np.inf, 1.0], [-1.0, -1.0]):
        assert excluded(q, a, b, [1, 1], np.array(z)) == 0.0


def test_what_is_found_verifies() -> None:
    found = lyapunov(A).solve()
    assert found.holds
    assert -largest_eigenvalue(symmetric_part(found.matrices["P"] @ A)) == pytest.approx(found.margin)


def test_the_matrices_of_a_known_gamma_are_those_of_its_scale() -> None:
    """x' = -x + w, z = x: gamma = 1 is the least; at gamma = 4 the matrices hold for z scaled as the result says."""

    def build(scale: float) -> LmiProgram:
        program = LmiProgram()
        program.symmetric("P", 1)
        program.matrix("g2", 1, 1)
        program.require("P > 0", lambda p: -p, "P")
        program.require("bounded real", lambda p, g2: symmetric_blocks([[-2.0 * p + scale**2], [p, -g2]]), "P", "g2")
        return program

    found = at_gamma(build, 4.0, "a lag")
    held = with_gamma(build(found.scale), found.scale * found.gamma)
    margin, _ = verify(held.inequalities, found.found.matrices)
    assert margin == pytest.approx(found.found.margin)
    assert smallest_gamma(build, "a lag").gamma == pytest.approx(1.0, rel=2e-3)


def test_absence_is_proved_by_dual_matrices_and_not_by_a_status() -> None:
    found = decide(lyapunov(A + np.eye(2)))  # unstable
    assert not found.holds and found.refused and found.excluded >= 100.0
    assert "dual matrices prove" in found.explain()


def test_minimum_is_that_of_the_closed_form() -> None:
    # smallest t with [[-t, 1], [1, -1]] <= 0 is 1; gamma of 1/(s+2): t = gamma^2 = 1/4
    program = LmiProgram()
    program.matrix("t", 1, 1)
    program.symmetric("P", 1)

    def bounded_real(p: np.ndarray, t: np.ndarray) -> np.ndarray:
        return symmetric_blocks([[-4.0 * p + 1.0], [p, -t]])

    program.require("bounded real", bounded_real, "P", "t")
    assert program.solve("t").objective == pytest.approx(0.25, rel=1e-5)


def test_probing_reads_every_coefficient() -> None:
    rng = np.random.default_rng(0)
    left, right, constant = rng.standard_normal((3, 3)), rng.standard_normal((2, 3)), np.diag([1.0, 2.0, 3.0])
    program = LmiProgram()
    program.symmetric("P", 3)
    program.matrix("Y", 3, 2)

    def function(p: np.ndarray, y: np.ndarray) -> np.ndarray:
        return symmetric_part(p @ left + y @ right) + constant

    program.require("any", function, "P", "Y")
    fixed, linear, columns = program.coefficients(program.inequalities[0])
    x = rng.standard_normal(program.size)
    values = {name: variable.value(x) for name, variable in program.variables.items()}
    assert fixed + np.tensordot(x[columns], linear, axes=1) == pytest.approx(function(values["P"], values["Y"]))


def test_blocks_work_in_floats_under_batches_and_in_fractions() -> None:
    batch = symmetric_blocks([[np.zeros((5, 1, 1))], [np.ones((2, 1)), np.eye(2)]])
    assert batch.shape == (5, 3, 3) and (batch[2, 1:, 0] == 1).all() and (batch[2, 0, 1:] == 1).all()
    exact = symmetric_blocks([[as_fraction([[1]])], [as_fraction([[0.5]]), as_fraction([[1]])]])
    assert exact[0, 1] == Fraction(1, 2) and pivots(exact) == [Fraction(1), Fraction(3, 4)]


def test_nothing_that_is_not_finite_verifies() -> None:
    item = Inequality(name="any", function=lambda p: -p, on=("P",))
    assert verify([item], {"P": np.full((1, 1), np.nan)}) == (-np.inf, -np.inf)


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 5), st.integers(0, 10_000))
def test_exact_pivots_agree_with_eigenvalues(size: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((size, size))
    matrix = root @ root.T - rng.uniform(0, 1.0) * np.eye(size)
    matrix = 0.5 * (matrix + matrix.T)
    smallest = np.linalg.eigvalsh(matrix)[0]
    if abs(smallest) > 1e-9:
        found = pivots(as_fraction(matrix))
        assert (min(found) > 0) == (smallest > 0)
        if smallest > 0:
            assert float(np.prod([float(p) for p in found])) == pytest.approx(np.linalg.det(matrix), rel=1e-6)


def test_exact_proof_names_what_fails() -> None:
    items = [
        Inequality(name="good", function=lambda p: -p, on=("P",)),
        Inequality(name="bad", function=lambda p: p, on=("P",)),
    ]
    known = {"P": rounded(np.eye(2), 10)}
    assert prove_inequalities(items[:1], known, 10).proved
    proof = prove_inequalities(items, known, 10)
    assert not proof.proved and proof.failed == "bad" and proof.smallest_pivot == -1
    with pytest.raises(ValueError, match="is not symmetric"):
        pivots(as_fraction([[1, 2], [0, 1]]))
