"""What a controller process asks of its link, and what it says of a link of the user's own that raises."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from hil.compose import compose
from hil.compose.changed import changed
from hil.errors import Terminated
from hil.experiment import load_experiment
from hil.rig.loop import Loop
from hil.runtime.changes import Change, ChangeReceiver, ChangeSenders
from hil.runtime.nodes import session_wire
from hil.runtime.nodes.controller_node import ControlNode
from hil.runtime.real import controller_process
from hil.runtime.real.controller_process import ControllerReport, _answer_next, serve
from tests.hil.cli.conftest import run_main
from transport import LinkCounters
from transport.links import Closing, Link, zenoh_refusals
from transport.links.contract import memory_pair
from transport.packets import ControlPacket, SensorPacket, decode, encode_sensor

OPEN = "hil.runtime.real.controller_process.open_link"


@pytest.fixture(scope="module")
def loop() -> Loop:
    return compose(load_experiment("dc-motor-local"), certify=False)


def test_a_controller_says_to_its_link_how_long_its_rig_is_silent(loop: Loop, monkeypatch: pytest.MonkeyPatch) -> None:
    """By it a link with a key knows a slot of a slow loop from a rig that has ended."""
    asked: list[tuple[str, str, float]] = []

    def opened(uri: str, role: str, period_s: float = 0.0) -> None:
        asked.append((uri, role, period_s))
        raise Terminated(15)

    monkeypatch.setattr(OPEN, opened)
    with pytest.raises(Terminated):
        serve(loop, "can:hil:x")
    assert asked == [("can:hil:x", "controller", float(loop.experiment.period))]


def test_a_controller_takes_no_reference_that_comes_behind_its_slot(loop: Loop) -> None:
    """The rig refuses it, and the log says that nothing was changed."""
    senders, node, wire = ChangeSenders(True), ControlNode(loop), session_wire(bytes(16), 10)
    receiver = ChangeReceiver(os.dup(senders.open("controller")))
    rig, controller = memory_pair()

    def answer(k: int) -> float:
        sample_ns = k * loop.experiment.period_ns
        rig.send(encode_sensor(SensorPacket(k, 0, sample_ns, (0.0,), nonce=wire.nonce(k), counter=1)))
        assert _answer_next(node, controller, receiver)
        found = decode(rig.receive(0.0) or b"")
        assert isinstance(found, ControlPacket)
        return found.rows[0][0]

    def change(slot: int, era: int) -> None:
        after = changed(loop, slot, "reference", [1.0])
        senders.put("controller", slot, Change(path="reference", value=[1.0], loop=after, era=era))
        senders.flush()

    change(0, 0)  # comes while slot 0 is answered
    assert [answer(0), answer(1), answer(2)] == [0.0, 0.0, 0.0]
    change(4, 1)
    assert answer(3) == 0.0 and answer(4) != 0.0
    senders.close()


OWN = """
from transport import LinkCounters

class Own:
    uri = "own:"

    def __init__(self, where, ended):
        self.where, self.ended = where, ended

    def __enter__(self):
        return self

    def __exit__(self, *given):
        self.at("close")

    @property
    def counters(self):
        self.at("counters")
        return LinkCounters(received=3)

    def receive(self, timeout_s):
        self.at("receive")
        raise self.ended

    def at(self, where):
        if where == self.where:
            raise OSError(f"{where} failed")
"""


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> type[Link]:
    (tmp_path / "own_link.py").write_text(OWN)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "own_link", raising=False)
    from own_link import Own  # type: ignore[import-not-found]

    return Own  # type: ignore[no-any-return]


@pytest.mark.parametrize("where", ["receive", "counters", "close"])
def test_what_a_link_raises_is_said_wherever_it_does(
    where: str, own: type, loop: Loop, monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[ControllerReport] = []
    monkeypatch.setattr(OPEN, lambda uri, role, period_s: own(where, Terminated(15)))
    assert serve(loop, "own:", at_end=said.append).startswith(f"OSError: {where} failed (")
    order = {"receive": [True, False], "counters": [True], "close": [False, True]}  # reports of a failure and of counts
    assert [each.failed is not None for each in said] == order[where]
    assert where == "counters" or sum(each.counts.get("received", 0) for each in said) == 3


def test_the_command_of_a_controller_says_what_was_raised(
    own: type, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(OPEN, lambda uri, role, period_s: own("receive", Terminated(15)))
    monkeypatch.setattr(zenoh_refusals, "_free", False)  # the command sets it
    assert run_main("controller", "dc-motor-local", "--link", "can:hil:x") == 1
    assert "\nhil: OSError: receive failed (" in capsys.readouterr().err


class Idle(Closing):
    """A link over which nothing comes but a signal."""

    uri, counters = "idle:", LinkCounters()

    def receive(self, timeout_s: float) -> None:
        raise Terminated(15)

    def close(self) -> None:
        pass


def test_a_controller_that_is_asked_to_end_reports_once(loop: Loop, monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[ControllerReport] = []
    monkeypatch.setattr(controller_process, "open_link", lambda uri, role, period_s: Idle())
    with pytest.raises(Terminated):
        serve(loop, "idle:", at_end=said.append)
    assert len(said) == 1 and said[0].failed is None and said[0].counts["received"] == 0


@pytest.mark.parametrize("malformed", [0, 7])
def test_the_command_of_a_controller_says_at_its_end_which_frames_it_did_not_take(
    malformed: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    link = Idle()
    link.counters = LinkCounters(received=3, malformed=malformed)
    monkeypatch.setattr(OPEN, lambda uri, role, period_s: link)
    monkeypatch.setattr(zenoh_refusals, "_free", False)  # the command sets it
    assert run_main("controller", "dc-motor-local", "--link", "can:hil:x") == 143
    assert ("\nhil: link received 3, malformed 7\n" in capsys.readouterr().err) == bool(malformed)
