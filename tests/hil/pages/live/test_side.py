"""A run that is watched takes changes for slots that have not begun, in their order, and each once."""

from __future__ import annotations

from hil.pages.live.side import Side
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
