"""A run that is watched takes changes for slots that have not begun, in their order, and each once."""

from __future__ import annotations

import pytest

from hil.compose.changed import changed
from hil.compose.loop import compose
from hil.experiment import load_experiment
from hil.log.topics import channels_of
from hil.pages.live.desk import Desk
from hil.pages.live.side import Side
from hil.rig.loop import Loop
from hil.runtime.changes import Change

FIRST, SECOND = (Change(path=path, value=1, loop=None) for path in ("a", "b"))


def test_a_change_acts_once_from_its_slot_on_and_none_is_armed_for_a_slot_that_has_begun() -> None:
    side = Side(acts=True)
    due = side.changes
    assert due is not None and Side().changes is None
    assert side.next_slot() == 0 and side.arm(0, FIRST) and side.next_slot() == 0, "several may share a slot"
    assert side.arm(3, SECOND) and side.next_slot() == 3
    assert due(0) == [FIRST] and not side.arm(0, FIRST) and side.next_slot() == 3
    assert due(1) == due(2) == [] and due(3) == [SECOND] and due(4) == []
    assert not side.arm(4, FIRST) and side.next_slot() == 5 and side.arm(5, FIRST) and side.arm(6, SECOND)
    assert due(9) == [FIRST, SECOND] and side.next_slot() == 10


def test_a_change_that_takes_many_slots_to_compose_is_armed_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """In real time the run goes on meanwhile: on a busy machine no change came ahead of it, and the page waited for ever."""
    side, loop = Side(acts=True), compose(load_experiment("dc-motor-hinf"))
    side.begin(loop, channels_of(loop))
    due, asked = side.changes, []
    assert due is not None
    due(0)

    def slowly(before: Loop, k: int, path: str, value: object) -> Loop:
        asked.append(k)
        assert len(asked) < 10
        due(side.next_slot() + 39)
        return changed(before, k, path, value)

    desk = Desk([side])
    try:
        monkeypatch.setattr(desk._composer, "changed", slowly)
        (slot,) = desk._arm([side], "network.ca.law", {"kind": "constant", "age": 1})
        assert slot == asked[-1] > side.next_slot() - 40 and len(asked) <= 3 and due(slot)
    finally:
        desk.close()
