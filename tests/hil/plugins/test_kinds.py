"""A kind that is spelt otherwise is understood, and what it gives in the wrong form is told as such."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from design.controllers import LoopModel
from hil.errors import HilError
from hil.plugins.checks import check_answers
from hil.plugins.registry import MEANT, Group, load, names


@pytest.mark.parametrize(
    ("group", "word", "kind"),
    [
        ("hil.plants", "linear", "state-space"),
        ("hil.plants", "State_Space", "state-space"),
        ("hil.controllers", "Kalman", "output-feedback"),
        ("hil.laws", "bernoulli", "packet"),
        ("hil.laws", "markow", "markov"),
    ],
)
def test_a_word_of_the_field_is_answered_with_the_kind_that_it_means(group: Group, word: str, kind: str) -> None:
    with pytest.raises(HilError, match=f"is called '{word}'; did you mean '{kind}'"):
        load(group, word)


def test_a_word_that_means_nothing_here_gets_no_guess() -> None:
    with pytest.raises(HilError, match=r"is called 'xyzzy' \(there are: "):
        load("hil.plants", "xyzzy")


@pytest.mark.parametrize("group", MEANT)
def test_every_kind_that_is_offered_is_installed_and_no_word_means_two(group: Group) -> None:
    words = [word for meant in MEANT[group].values() for word in meant]
    assert set(MEANT[group]) <= set(names(group))
    assert len(set(words)) == len(words)
    assert not set(words) & set(names(group))


@dataclass(frozen=True)
class Answers:
    """A controller whose rows are what the test says."""

    gives: object
    selection: str = "constant"

    def start(self, model: LoopModel) -> Answers:
        return self

    def rows(self, k: int, tau: int, y: object, r: object) -> object:
        return self.gives


@pytest.mark.parametrize(
    ("gives", "said"),
    [
        (0.5, r"rows\(\) returned 0.5, expected 1 row of 1 input in a tuple of tuples"),
        ((0.5,), r"rows\(\) returned \(0.5,\), expected 1 row of 1 input in a tuple of tuples"),
        (None, r"rows\(\) returned None, expected 1 row of 1 input"),
        (np.zeros((1, 1)), r"rows\(\) returned array.*in a tuple of tuples; \.tolist\(\) makes lists of an array"),
        ((np.zeros(1),), r"in a tuple of tuples; \.tolist\(\) makes"),
        (((0.5,), (0.5,)), "2 rows, expected 1 for 'constant'"),
        (((0.5, 0.5),), r"a row of rows\(\) has 2 numbers, expected 1"),
        (((float("nan"),),), "a row is not finite"),
    ],
)
def test_rows_of_a_wrong_form_are_refused_as_such(gives: object, said: str) -> None:
    model = LoopModel(A=np.eye(1), B=np.eye(1), C=np.eye(1), period_s=0.05, tau_max=1, d_max=1)
    with pytest.raises(AssertionError, match=said):
        check_answers(Answers(gives), model)  # type: ignore[arg-type]
