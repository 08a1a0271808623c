"""Radius and cost by one class of a periodic chain are those of all modes; growth in every order is bounded from above."""

from __future__ import annotations

import numpy as np
import pytest

from design.errors import NotStable
from design.jump_linear import certificate, order_of_modes
from design.jump_linear.order_of_modes import cyclic_classes, growth_in_every_order, parts, periodic_cost, periodic_radius
from design.jump_linear.second_moment import backward, mean_square_radius, operator_matrix


def in_turn(classes: int, each: int, n: int, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Random modes in shuffled classes, each followed by the next."""
    rng = np.random.default_rng(3)
    of, transition = rng.permutation(np.repeat(range(classes), each)), np.zeros((classes * each, classes * each))
    for i, own in enumerate(of):
        transition[i, of == (own + 1) % classes] = rng.dirichlet(np.ones(each))
    return size * rng.normal(size=(classes * each, n, n)), transition


def test_radius_and_cost_are_those_of_all_modes() -> None:
    A, transition = in_turn(3, 14, 6, 0.35)
    classes = cyclic_classes(transition)
    assert sorted(map(len, classes)) == [14, 14, 14]
    following = [*classes[1:], classes[0]]
    assert all(transition[np.ix_(now, later)].sum() == pytest.approx(14) for now, later in zip(classes, following))
    radius = periodic_radius(A, transition)
    assert radius == pytest.approx(mean_square_radius(A, transition), rel=1e-9) and 0.5 < radius < 1
    Q = np.broadcast_to(np.eye(6), A.shape)
    S = periodic_cost(A, transition, Q)
    np.testing.assert_allclose(S, Q + backward(A, transition, S), rtol=0, atol=1e-10 * np.abs(S).max())


def test_a_cost_on_the_edge_is_not_found_and_an_aperiodic_chain_is_one_class() -> None:
    A, transition = in_turn(3, 14, 6, 0.35)
    with pytest.raises(NotStable, match="too near to one that is not mean-square stable"):
        periodic_cost(A / np.sqrt(periodic_radius(A, transition)), transition, np.broadcast_to(np.eye(6), A.shape))
    transition[0, 0] = 0.5
    assert len(cyclic_classes(transition)) == 1 and len(cyclic_classes(np.eye(3))) == 1


def test_what_arpack_has_not_found_is_not_its_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    A, transition = in_turn(3, 14, 6, 0.35)
    whole = periodic_radius(A, transition)

    def tired(*given: object, **named: object) -> None:
        from scipy.sparse.linalg import ArpackNoConvergence

        assert 0 < int(str(named["maxiter"])) < 1000
        raise ArpackNoConvergence("tired", np.array([0.5 * whole]), np.zeros((1, 1)))

    monkeypatch.setattr("scipy.sparse.linalg.eigs", tired)
    assert periodic_radius(A, transition) == pytest.approx(whole, rel=1e-9)
    monkeypatch.setattr(order_of_modes, "EIG_DENSE_AFTER", 10)
    assert whole <= periodic_radius(A, transition) < 1.0 and np.isnan(periodic_radius(A, transition, bounded=False))


@pytest.mark.parametrize("left", [0.0, 0.9])
def test_two_cycles_side_by_side_and_a_mode_before_them_are_taken_apart(left: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Cycles of 6 and 9 slots meet in three of their phases, 18 slots each; a mode that is left with 1 - `left` leads to all."""
    cycle = np.kron(*(np.roll(np.eye(n), 1, axis=1) for n in (6, 9)))
    transition = np.block([[np.full((1, 1), left), np.full((1, 54), (1.0 - left) / 54)], [np.zeros((54, 1)), cycle]])
    A = 0.3 * np.random.default_rng(2).normal(size=(55, 3, 3))
    whole = np.abs(np.linalg.eigvals(operator_matrix(A, transition))).max()
    monkeypatch.setattr(order_of_modes, "largest_by_arpack", None)  # not asked for
    assert periodic_radius(A, transition) == pytest.approx(whole, rel=1e-9)
    assert not parts(0.0 * A, 0.0 * transition) and periodic_radius(A, 0.0 * transition) == 0.0
    monkeypatch.setattr(order_of_modes, "_product_radius", lambda matrices: float("nan"))
    assert np.isnan(periodic_radius(A, transition))
    if left:
        A[0] *= np.sqrt(2.0 / left) / np.abs(np.linalg.eigvals(A[0])).max()
        assert periodic_radius(A, transition) == pytest.approx(2.0)  # it decides, whatever the cycles do


def test_one_part_that_grows_proves_that_all_modes_together_do(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two independent chains of 70 modes, of which one shrinks; products of all modes together are not asked."""
    transition = np.kron(np.eye(2), np.full((70, 70), 1.0 / 70))
    A = np.repeat([1.1, 0.5], 70)[:, None, None] * np.eye(2)
    monkeypatch.setattr(certificate, "side_of_one", None)  # not asked for
    assert certificate.grows(A, transition, 1.21)


def test_the_growth_is_rounded_up() -> None:
    """Of one mode 0.3 it is 0.09; what rounding may have taken is added."""
    found = growth_in_every_order(np.full((1, 1, 1), 0.3), np.ones((1, 1), dtype=bool))
    assert 0.09 + 1e-12 < found.growth < 0.09 + 1e-9


@pytest.mark.parametrize(("most", "solver"), [(2, "Clarabel"), (1, "")])
def test_a_solver_is_asked_for_no_more_modes_than_it_can_do(most: int, solver: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The P of the chain prove 1.09 of two modes whose products grow by 0.866 at least; a solver's prove 0.88."""
    monkeypatch.setattr(order_of_modes, "MOST_OF_SOLVER", most)
    A = np.array([[[-0.4, -0.2], [0.3, 0.8]], [[-0.1, 1.1], [-0.5, 0.3]]])
    found = growth_in_every_order(A, np.ones((2, 2), dtype=bool))
    assert found.solver == solver and (found.growth < 1.0) is bool(solver)
