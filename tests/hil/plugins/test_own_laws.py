"""Network laws of a user's own: checked when an experiment is read, in the author's words; objects in the place of tables."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

import hil
from hil.experiment import shipped
from hil.log.read import read_run
from hil.plugins.checks import check_law
from transport.draws import SENT, Draw

OVER: dict[str, Any] = {"duration": 2, "allow_uncertified": True}


class Coin:
    """Age 0 or 1, by the toss of a coin."""

    family = "age"
    max_age: Any = 1
    mode_ages = (0, 1)

    def __init__(self, share: float = 0.3, draw: Callable[[int], Any] | None = None) -> None:
        self.share, self._draw = share, draw

    def transition_matrix(self) -> Any:
        return np.array([[1.0 - self.share, self.share]] * 2)

    def start(self, rng: np.random.Generator) -> Any:
        class Running:
            k = 0

            def draw(_self) -> Any:
                _self.k += 1
                if self._draw is not None:
                    return self._draw(_self.k)
                mode = int(rng.random() < self.share)
                return mode, mode

        return Running()


class Bare:
    """As the guide had it: nothing says what start returns, nor that a family is asked for."""

    max_age = 2

    def start(self, rng: np.random.Generator) -> Any:
        return lambda: 1


class WithFamily(Bare):
    family = "age"


class NoArgument(WithFamily):
    def start(self) -> Any:  # type: ignore[override]
        return self


class Packets(WithFamily):
    family = "packet"


class NoBound(Coin):
    max_age = "two"


class OneRow(Coin):
    def transition_matrix(self) -> Any:
        return [[0.7, 0.3]]


class NoRow(Coin):
    def transition_matrix(self) -> Any:
        return [[0.7, 0.2], [0.7, 0.3]]


class OwnSeed(Coin):
    def start(self, rng: np.random.Generator) -> Any:
        return super().start(np.random.default_rng(1))


def leaves(k: int) -> Any:
    if k > 9:
        raise SystemExit(0)
    return 0, 0


@pytest.mark.parametrize(
    ("law", "reported"),
    [
        (Bare(), r"Bare, a network law, needs `family` \(\"age\" for ages in slots, "),
        (WithFamily(), r"what start\(rng\) returns needs `draw` \(draw\(\) gives \(mode, age\)"),
        (NoArgument(), r"NoArgument\.start\(rng\): TypeError: .*takes 1 positional argument"),
        (Packets(), r"Packets, a network law of family \"packet\", needs `reordering` .*`queue`"),
        (NoBound(), r"NoBound\.max_age is 'two', expected a whole number of slots"),
        (Coin(draw=lambda k: 1), r"draw\(\) returned 1, expected \(mode, age\)"),
        (Coin(draw=lambda k: (0, 0.5)), r"draw\(\) returned \(0, 0\.5\), expected \(mode, age\)"),
        (Coin(draw=lambda k: (0, 3)), r"draw\(\) gave an age outside 0 \.\. 1"),
        (Coin(draw=lambda k: {}["x"]), r"draw\(\): KeyError: 'x' \(.*test_own_laws\.py, line \d+\)"),
        (Coin(draw=leaves), r"draw\(\) of slot \d+: SystemExit: 0"),
        (Coin(draw=lambda k: (k % 2, k % 2)), r"the drawn modes do not follow the stated chain"),
        (OwnSeed(), r"OwnSeed\.start\(rng\): two starts with two seeds draw the same modes; draw from rng alone"),
        (OneRow(), r"transition_matrix\(\) of shape \(1, 2\), expected \(2, 2\)"),
        (NoRow(), r"transition_matrix\(\): row 0 sums to 0\.9"),
        (object(), r"object, a network law, needs `family` .* `start`"),
    ],
)
def test_a_law_that_is_none_is_refused_in_its_author_s_words(law: Any, reported: str) -> None:
    with pytest.raises(hil.HilError, match=r"network\.sc\.law: .*check_law: " + reported) as said:
        hil.load_experiment("dc-motor-hinf", **{"network.sc.law": law})
    assert "plugin_checks" not in str(said.value) and "law_checks" not in str(said.value)  # no line of ours
    assert "AttributeError" not in str(said.value)
    with pytest.raises(AssertionError, match=reported):
        check_law(law)


def test_a_law_of_a_file_is_checked_when_it_is_read(tmp_path: Path) -> None:
    text = "from dataclasses import dataclass\n\n@dataclass(frozen=True)\nclass L:\n    max_age: int = 2\n"
    (tmp_path / "mine.py").write_text(text + "    def start(self, rng):\n        return lambda: 1\n")
    (tmp_path / "exp.toml").write_text(shipped()["dc-motor-hinf"].read_text())
    for path in ("network.sc.law", "network.ca.law"):
        with pytest.raises(hil.HilError, match=path + r": 'mine:L': check_law: L, a network law, needs `family`"):
            hil.load_experiment(tmp_path / "exp.toml", **{path: {"kind": "mine:L"}})


@dataclass(frozen=True)
class Toss(Coin):
    share: float = 0.3
    _draw: ClassVar = None


def test_an_object_is_a_law_certified_logged_and_taken_again(tmp_path: Path) -> None:
    log, laws = tmp_path / "a.mcap", {"network.sc.law": Coin(0.3), "network.ca.law": Toss(0.5)}
    session = hil.run("dc-motor-hinf", log=log, duration=2, **laws)  # type: ignore[arg-type]
    assert session.summary["certificate"]["state"] == "certified"
    run = read_run(log)
    assert run.metadata["network.sc.law"] == f"object {__name__}.Coin (not in the experiment file)"
    assert run.resolved["network"]["sc"] == {"law": {"kind": f"object {__name__}.Coin"}, "max_age": 1}
    assert run.resolved["network"]["ca"]["law"] == {"kind": f"object {__name__}.Toss", "share": 0.5}
    with pytest.raises(hil.HilError, match=r"network\.sc\.law\.kind: 'object .*Coin' cannot be made .*laws="):
        hil.verify(log)
    assert hil.verify(log, laws=laws).difference is None
    assert len(hil.sweep("dc-motor-hinf", runs=2, duration=1, jobs=1, **laws).values["sse"]) == 2


@pytest.mark.realtime
def test_a_law_of_python_runs_in_real_time() -> None:
    session = hil.run("dc-motor-hinf", clock="real", link="local:", duration=2, **{"network.sc.law": Coin()})
    assert session.summary["slots"] == 40


def test_a_check_says_what_the_law_has_earned() -> None:
    assert "Coin is a ChainLaw: loops over it can be certified, designed for and predicted" in check_law(Coin())


class InTurn(Packets):
    """A packet law that draws for one slot after the other, as they are asked for in a loop: of others it has no numbers."""

    reordering, queue = True, 1

    def start(self, rng: np.random.Generator, period_s: float, deadline_s: float) -> Any:  # type: ignore[override]
        class Running:
            slots = iter(range(10**6))

            def draw(_self, k: int) -> list[Draw]:
                assert k == next(_self.slots)
                return [Draw(k, k, 0, 0, 1e-3, SENT)]

        return Running()


def test_a_packet_law_is_asked_for_slot_after_slot_as_in_a_loop() -> None:
    assert check_law(InTurn())[0] == "InTurn is a PerPacketLaw: it can run in a loop"  # type: ignore[arg-type]
