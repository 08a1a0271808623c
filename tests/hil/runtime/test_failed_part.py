"""A part of the user's own that returns what has no form, long after its check, is one problem of a run, elsewhere one error."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import hil
from design.controllers import LoopModel
from plants import DCMotor
from tests.hil.compose.lying_plugins import Table
from transport import MarkovAge


class Odd:
    """A running part that returns something else from the thousandth time on."""

    def __init__(self, run: Any, method: str, given: object) -> None:
        self.run, self.method, self.given, self.asked = run, method, given, 0

    def __getattr__(self, name: str) -> Any:
        return self.ask if name == self.method else getattr(self.run, name)

    def ask(self, *asked: Any) -> Any:
        self.asked += 1
        return getattr(self.run, self.method)(*asked) if self.asked < 1000 else self.given


class OddMotor(DCMotor):
    def start(self, rng: np.random.Generator) -> Any:
        return Odd(DCMotor.start(self, rng), "measure", GIVEN["plant"])

    def start_batch(self, runs: int) -> None:
        return None


@dataclass(frozen=True)
class OddTable(Table):
    def start(self, model: LoopModel) -> Any:
        return Odd(Table.start(self, model), "rows", GIVEN["controller"])


class OddLaw(MarkovAge):
    def start(self, rng: np.random.Generator) -> Any:
        return Odd(MarkovAge.start(self, rng), "draw", GIVEN["network.sc.law"])


GIVEN: dict[str, object] = {"plant": (0.0, 0.0), "controller": None, "network.sc.law": 1}
PARTS: dict[str, Any] = {
    "plant": OddMotor(gain=172.38, pole=3.5287), "controller": OddTable(), "network.sc.law": OddLaw(matrix=((0.5, 0.5),) * 2),
}  # fmt: skip


@pytest.mark.parametrize("path", PARTS)
def test_an_answer_without_its_form_is_one_problem_and_a_whole_log(path: str) -> None:
    changes = {path: PARTS[path], "duration": 60, "allow_uncertified": True}
    said = f"{type(PARTS[path]).__name__}: it returned something of another form than in its check: TypeError: "
    session = hil.run("dc-motor-h2", **changes)
    assert session.status == 1 and session.summary["problems"]["plug_in_failed"].startswith(said)
    assert 990 < len(session.arrays["/plant/state"]) < 1010
    with pytest.raises(hil.HilError, match=f"plug in failed: {said[:60]}"):
        hil.sweep("dc-motor-h2", runs=2, jobs=1, **changes)


@pytest.mark.parametrize(
    ("rows", "said"), [(((np.nan,), (0.0,)), "a row is not finite"), (((0.0,),), "1 rows of 1, expected 2 of 1 for 'applied'")]
)
def test_a_packet_that_the_rig_refuses_is_a_problem_with_its_reason(
    monkeypatch: pytest.MonkeyPatch, rows: object, said: str
) -> None:
    monkeypatch.setitem(GIVEN, "controller", rows)
    session = hil.run("dc-motor-h2", controller=PARTS["controller"], duration=60, allow_uncertified=True)
    assert session.status == 7 and "watchdog" in session.summary["safety"]  # its certificate is withdrawn, too
    assert session.summary["problems"]["control_refused"] == f"control packet refused: {said}"


def test_a_list_of_outputs_is_sent_as_a_tuple_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compiled, the loop takes nothing but a tuple: what an author's part returns becomes one where it enters."""
    sent = []
    for given in ((0.5,), [0.5], np.array([0.5])):
        monkeypatch.setitem(GIVEN, "plant", given)
        found = hil.run("dc-motor-h2", plant=PARTS["plant"], duration=60, allow_uncertified=True)
        sent.append(found.arrays["/controller/rows"])
    for rows in sent:
        np.testing.assert_array_equal(sent[0], rows)


@dataclass(frozen=True)
class Lists(Table):
    """Answers by a list of lists, as its check allows."""

    def start(self, model: LoopModel) -> Any:
        run = Table.start(self, model)
        return SimpleNamespace(selection=run.selection, rows=lambda *known: [[*row] for row in run.rows(*known)])


def test_rows_in_lists_are_sent_as_in_tuples() -> None:
    found = [hil.run("dc-motor-h2", controller=each, duration=10, allow_uncertified=True) for each in (Table(), Lists())]
    one, other = (session.arrays["/controller/rows"] for session in found)
    np.testing.assert_array_equal(one, other)
    assert len(one) > 190 and found[1].status == 0
