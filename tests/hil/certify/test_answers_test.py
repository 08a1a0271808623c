"""The excitation of a controller before a run, and the mismatches of its answers to those of its table."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from typing import Any

import numpy as np
import pytest

from design.controllers import LoopModel, OutputFeedback, SendAll, SensorNodes, nested
from hil.certify.answers_test import FAR, SLOTS, drift_at_zero, growing_feedforward, mismatches, random_excitation, shares_memory

TWO = SensorNodes(names=("a", "b"), outputs=((0,), (1,)), buffers=(1, 1), delays=(None, None))


def model(sensors: SensorNodes | None = None, outputs: int = 1) -> LoopModel:
    return LoopModel(
        A=0.5 * np.eye(2), B=np.ones((2, 1)), C=np.eye(2)[:outputs], period_s=0.1, tau_max=3, d_max=1, sensors=sensors
    )  # fmt: skip


@pytest.mark.parametrize(("sensors", "outputs"), [(None, 1), (TWO, 2)])
def test_every_age_is_asked_for_longer_than_any_gain_distinguishes_and_late_in_a_run(sensors: Any, outputs: int) -> None:
    excitation = random_excitation(model(sensors, outputs), width=3, longest=5, far=True)
    for column in excitation.ages.T:
        stays = [(age, len(list(run))) for age, run in groupby(column.tolist())]
        assert {age for age, _ in stays} == {0, 1, 2, 3} and max(length for _, length in stays) > 5
    assert excitation.ages.shape == (SLOTS, outputs)
    assert excitation.samples.shape == (SLOTS, 3) and np.abs(excitation.samples).max() <= 1.0
    assert excitation.slots == (*range(3, 3 + SLOTS - len(FAR)), *FAR) and excitation.reference == (1.0,) * outputs
    near = random_excitation(model(), width=1, slots=300, far=True)
    assert near.slots == tuple(range(3, 303)) and not near.received and not near.modes
    assert random_excitation(model(), width=1, reference=0.0).reference == (0.0,)


def sends(K: np.ndarray) -> Any:
    return lambda: SendAll(gains=nested(K), selection="applied").start(model())


K = np.arange(1.0, 9.0).reshape(4, 2, 1, 1)
EXCITATION = random_excitation(model(), width=1, reference=0.0)
NODES = model().nodes


def at_zero() -> tuple[np.ndarray, np.ndarray]:
    return np.zeros((SLOTS, 2, 1)), np.zeros((SLOTS, 2, 1))


def test_a_row_of_one_age_that_differs_is_named_with_both_numbers() -> None:
    other = K.copy()
    other[2, 1] *= 1.25
    (same,) = mismatches(sends(K), sends(K), at_zero(), EXCITATION, NODES, [1.0])
    assert same.share == 0.0
    for size, found in zip((0.1, 10.0), mismatches(sends(other), sends(K), at_zero(), EXCITATION, NODES, [0.1, 10.0])):
        first = int(np.flatnonzero(EXCITATION.ages[:, 0] == 2)[0])
        said = size * K[2, 1, 0, 0] * EXCITATION.samples[first, 0]
        assert (found.size, found.age, found.row, found.slot) == (size, 2, 1, EXCITATION.slots[first])
        assert found.foretold == pytest.approx(said) and found.found == pytest.approx(1.25 * said) and 0.05 < found.share <= 0.25
    one_row = SendAll(gains=nested(K[:, :1]), selection="constant")
    other_shape = (np.zeros((SLOTS, 1, 1)), np.zeros((SLOTS, 2, 1)))
    (short,) = mismatches(lambda: one_row.start(model()), sends(K), other_shape, EXCITATION, NODES, [1.0])
    assert short.share == np.inf


def test_a_wrong_answer_is_found_beside_a_state_that_grows_without_bound() -> None:
    """Of 1.8^120 at the end the first answers are nothing; there it is seen that u = x - 4 y is not u = x + 4 y."""
    said, other = (OutputFeedback(A=((1.8,),), B=((0.1,),), C=((1.0,),), D=((d,),)) for d in (-4.0, 4.0))
    for own, least, most in ((said, 0.0, 1e-9), (other, 0.5, np.inf)):
        zero = np.zeros((SLOTS, 1, 1))
        (found,) = mismatches(
            lambda own=own: own.start(model()), lambda: said.start(model()), (zero, zero), EXCITATION, NODES, [1.0]  # type: ignore[misc]
        )
        assert least <= found.share <= most


def test_a_growing_feedforward_is_distinguished_from_a_bounded_one() -> None:
    far = random_excitation(model(), width=1, far=True)
    early, stated_at_zero = np.ones(SLOTS - len(FAR)), at_zero()[1]

    def with_late(*late: float) -> tuple[np.ndarray, np.ndarray]:
        return np.concatenate([early, late])[:, None, None] * np.ones((1, 2, 1)), stated_at_zero

    assert growing_feedforward(with_late(2.0, 3.0, 4.0, 5.0, 6.0), far) == (FAR[-1], 6.0, 1.0)
    assert growing_feedforward(with_late(2.0, 3.0, 4.0, 5.0, 5.4), far) is None  # by a tenth less
    assert growing_feedforward(with_late(1.0, 1.2, 1.5, 2.0, 2.9), far) is None
    assert growing_feedforward(with_late(2.0, 3.0, 4.0, 5.0, 6.0), EXCITATION) is None
    grown, _ = with_late(2.0, 3.0, 4.0, 5.0, 6.0)
    assert growing_feedforward((grown[:-1], stated_at_zero[:-1]), far) is None
    assert growing_feedforward((grown, stated_at_zero[:, :1]), far) is None


class Counts:
    """Answers how often it was asked, or how often all of its class were."""

    selection = "constant"
    calls = 0

    def __init__(self, step: float, shared: bool) -> None:
        self._own, self._step, self._shared = 0.0, step, shared

    def rows(self, k: int, tau: int, y: Sequence[float], r: Sequence[float]) -> tuple[tuple[float, ...], ...]:
        Counts.calls += 1
        self._own += self._step
        return ((y[0] - r[0] + (Counts.calls if self._shared else self._own),),)


def test_drifting_answers_and_shared_memory_are_found() -> None:
    assert drift_at_zero(lambda: Counts(0.0, False), EXCITATION, NODES) == 0.0
    assert drift_at_zero(lambda: Counts(0.5, False), EXCITATION, NODES) == pytest.approx(0.5 * (SLOTS - 1))
    assert drift_at_zero(lambda: Counts(0.0, True), EXCITATION, NODES) == np.inf
    Counts.calls = 0
    alone = np.arange(1.0, 1.0 + SLOTS)[:, None, None]
    assert shares_memory(lambda: Counts(0.0, True), alone, EXCITATION, NODES)
    assert not shares_memory(lambda: Counts(1.0, False), alone, EXCITATION, NODES)
