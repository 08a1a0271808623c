"""What is done once before a session: it answers as a session does, leaves no trace, and hides no fault of a control law."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from hil.compose.loop import compose
from hil.experiment import load_experiment
from hil.log.topics import channels_of
from hil.log.write.sinks import MemorySink
from hil.rig.loop import Loop
from hil.runtime.nodes.rig import Rig
from hil.runtime.nodes.wire import VIRTUAL, Wire, session_wire
from hil.runtime.real import warm_up
from hil.runtime.real.warm_up import WarmUpExchange, WarmUpRig, warm_up_controller
from hil.runtime.slot import Slot


@pytest.fixture(scope="module")
def loop() -> Loop:
    return compose(load_experiment("dc-motor-hinf"), certify=False)


@pytest.mark.parametrize("wire", [VIRTUAL, session_wire(bytes(16), 1000)])
def test_every_rehearsed_slot_is_answered_with_the_echo_of_the_session(loop: Loop, wire: Wire) -> None:
    rig = Rig(loop, 0, MemorySink(channels_of(loop), ()), channels_of(loop), lambda: None, wire)
    slot = Slot(rig, WarmUpExchange(loop, wire))
    for k in range(10):
        slot.run(k * loop.experiment.period_ns)
    assert rig.outcome()["late"] == rig.outcome()["foreign"] == 0
    rehearsed = WarmUpRig(loop, wire).warm_up()
    for _ in range(3):
        rehearsed.run()


class Law:
    """A control law that counts its slots, and fails or dawdles in one of them."""

    def __init__(self, loop: Loop, fails_in: int = -1) -> None:
        self.asked, self._running, self._fails_in = [], loop.start_controller(), fails_in
        self.selection = loop.selection

    def start(self, model: object) -> Law:
        return self

    def rows(self, k: int, *known: Any) -> Any:
        self.asked.append(k)
        if k == self._fails_in:
            raise ZeroDivisionError("of the law")
        return self._running.rows(k, *known)


def test_a_control_law_runs_before_the_session_and_may_fail_there(loop: Loop) -> None:
    for law in (Law(loop), Law(loop, fails_in=7)):
        warm_up_controller(replace(loop, controller=law))
        assert law.asked[-1] == (7 if law._fails_in == 7 else warm_up.SLOTS - 1)


def test_a_part_that_failed_is_not_asked_again_before_the_session(loop: Loop) -> None:
    for law, last in ((Law(loop), warm_up.SLOTS - 1), (Law(loop, fails_in=7), 7)):
        WarmUpRig(replace(loop, controller=law), VIRTUAL, local=True).warm_up()
        assert law.asked[-1] == last


def test_a_slow_control_law_does_not_hold_the_session(loop: Loop, monkeypatch: pytest.MonkeyPatch) -> None:
    law, clock = Law(loop), SimpleNamespace(t_ns=0)

    def now() -> int:
        clock.t_ns += 100_000_000
        return clock.t_ns

    monkeypatch.setattr(warm_up, "monotonic_ns", now)
    warm_up_controller(replace(loop, controller=law))
    assert 1 <= len(law.asked) <= 5
