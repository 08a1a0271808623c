"""A network law of the user's own that draws otherwise than its chain says loses the certificate in the run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pytest

from hil.runtime.nodes.jump_watch import LawWatch
from hil.session import simulated_session
from tests.hil.compose.lying_plugins import Plant, Table
from tests.hil.test_left_model import loop_of, said
from transport.draws import DELIVERED, Draw

P = np.array([[0.8, 0.2, 0.0], [0.7, 0.1, 0.2], [0.9, 0.1, 0.0]])


@dataclass(frozen=True)
class Law:
    """A chain of three modes, from slot 450 on with a lie."""

    lie: str = "none"
    kind: ClassVar = "own"
    family: ClassVar = "age"
    max_age: ClassVar = 2
    mode_ages: ClassVar = (0, 1, 2)
    initial: ClassVar = (1.0, 0.0, 0.0)

    def transition_matrix(self) -> np.ndarray:
        return P

    def initial_law(self) -> np.ndarray:
        return np.array(self.initial)

    def start(self, rng: np.random.Generator) -> Process:
        return Process(self.lie, rng)


class Process:
    def __init__(self, lie: str, rng: np.random.Generator) -> None:
        self.lie, self.rng, self.k, self.mode = lie, rng, -1, 0

    def draw(self) -> tuple[int, int]:
        self.k += 1
        if self.k:
            self.mode = int(self.rng.choice(3, p=P[self.mode]))
        drawn = LIES[self.lie](self) if self.k > 450 else self.mode
        return drawn if isinstance(drawn, tuple) else (drawn, drawn)


LIES: dict[str, Callable[[Process], Any]] = {
    "none": lambda run: run.mode,
    "always late": lambda run: 2,
    "a period": lambda run: run.k % 3,
    "another age": lambda run: (run.mode, 2),
    "a mode below 0": lambda run: (-1, 2),
    "from fresh to oldest": lambda run: 2 if run.mode == 1 else 0,
    "rarely fresh": lambda run: 1 + int(run.rng.random() < 0.2),
}


@pytest.mark.parametrize(("lie", "direction"), [*((lie, "sc") for lie in LIES), ("none", "ca"), ("always late", "ca")])
def test_a_law_that_departs_late_loses_the_certificate(lie: str, direction: str) -> None:
    changes = {f"network.{direction}.law": Law(lie), f"network.{direction}.max_age": 2, "duration": "30 s"}
    loop = loop_of(Plant(), Table(), **changes)
    assert loop.verdict is not None
    assert any(f"network.{direction}.law draws as the chain that it states" in said for said in loop.verdict.assumptions)
    why = said(simulated_session(loop, 3))
    assert why.startswith("certificate withdrawn: the network law Law left its chain at slot ") or (lie == "none" and not why)
    assert lie == "none" or 450 <= int(why.split(" slot ")[1].split()[0]) < 560


def test_a_law_that_begins_elsewhere_than_it_says_is_found_in_slot_0() -> None:
    watch = LawWatch(Law())
    watch.take([Draw(0, -1, 1, 1, 0.0, DELIVERED)])
    assert watch.departed() == (0, "mode 1, in which it never begins")


def test_a_right_law_loses_nothing() -> None:
    """At 1e-9 a run, 20 runs of a right law have a false alarm with probability 2e-8."""
    for seed in range(20):
        watch, draw = LawWatch(Law()), Process("none", np.random.default_rng(seed)).draw
        for k in range(800):
            mode, age = draw()
            watch.take([Draw(k, k - age, mode, age, 0.0, DELIVERED)])
        assert watch.departed() is None, seed


def test_a_law_of_ours_is_not_compared() -> None:
    loop = loop_of(Plant(), Table())
    assert loop.watched is not None and loop.watched.laws == ()
