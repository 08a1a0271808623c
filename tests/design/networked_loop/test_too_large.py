"""A loop that is too large is refused by its numbers before any of its matrices is made."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable

import numpy as np
import pytest

from design.controllers import LoopModel
from design.errors import TooLarge
from design.networked_loop import MOST_MODES, affine_loop, joint_modes
from design.networked_loop.closed_loop import loop_structure
from design.processes.delay_chain import DelayChain
from hil.certify import CertificationProblem
from hil.certify.certify import judge
from hil.compose import compose
from hil.experiment import load_experiment

PLANT = np.array([[1.0, 0.05], [0.0, 0.9]]), np.array([[0.0], [0.05]]), np.array([[1.0, 0.0]])


def even(modes: int) -> DelayChain:
    return DelayChain(transition=np.full((modes, modes), 1.0 / modes))


def peak_of(refused: Callable[[], object], why: str) -> int:
    """Return the most bytes that were held until it was refused."""
    tracemalloc.start()
    try:
        with pytest.raises(TooLarge, match=why):
            refused()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_rows_of_many_ages_are_refused_before_26_gib_are_asked_for() -> None:
    assert peak_of(lambda: loop_structure(*PLANT, even(28), even(28), "applied"), "784 modes over 408 states") < 50e6


def test_more_pairs_of_modes_than_a_matrix_holds_are_refused() -> None:
    one = even(MOST_MODES // 50)
    assert peak_of(lambda: joint_modes(one, even(51), order=2), f"{MOST_MODES // 50 * 51} joint modes") < 50e6
    assert peak_of(lambda: joint_modes(even(900), even(900), order=2), "810000 joint modes") < 50e6
    assert len(joint_modes(even(10), even(10), order=2)[0]) == 100


def test_modes_that_are_too_many_for_their_states_are_refused_before_their_matrix_is_made() -> None:
    chain = even(60)
    assert peak_of(lambda: joint_modes(chain, chain, order=50), "3600 modes over 50 states") < 20e6  # the matrix has 104 MB


def test_terms_are_added_in_parts_to_the_same_matrices(monkeypatch: pytest.MonkeyPatch) -> None:
    structure = loop_structure(*PLANT, even(3), even(3), "applied")
    gains = np.random.default_rng(3).normal(size=structure.gain_shape)
    whole = structure.matrices(gains)
    monkeypatch.setattr(affine_loop, "MOST_PRODUCTS", 2 * whole[0].size)
    assert np.array_equal(structure.matrices(gains), whole) and len(structure.entries.mode) > 2


@pytest.mark.parametrize("name", ["dc-motor-h2", "dc-motor-local", "dc-motor-smith"])
def test_the_door_says_undecided_with_the_numbers(name: str) -> None:
    made = compose(load_experiment(name, ("allow_uncertified=true",)))
    model: LoopModel = made.model
    assert made.chains is not None
    asked = CertificationProblem(
        plant=made.experiment.plant, controller=made.controller, model=model, sc=even(120), ca=even(120), digest="0" * 64,
    )  # fmt: skip
    said = judge(asked)
    assert said.state == "undecided" and "14400 joint modes, more than the 8000" in said.reason
