"""Changes on their way to a run in real time: once each, in order, without a wait."""

from __future__ import annotations

import os
from typing import Any

from msgspec import structs

from hil.log import CHANGE, encode_event
from hil.log.records import EVENTS_TOPIC
from hil.runtime.changes import END, LATE, Change, ChangeReceiver, ChangeSchedule, ChangeSenders

PERIOD_NS = 10_000_000


def change(number: int, size: int = 0) -> Change:
    return Change(path="reference", value=[float(number), "x" * size], loop=None)


def test_every_slot_is_asked_for_once_ahead_of_the_run() -> None:
    asked: list[int] = []

    def changes(k: int) -> list[Change]:
        asked.append(k)
        return [change(k)] if k % 7 == 0 else []

    ahead = ChangeSchedule(changes, PERIOD_NS)
    found = [k for now in (-1, 0, 0, 5 * PERIOD_NS, 40 * PERIOD_NS) for k, _ in ahead.at(now)]
    assert asked == list(range(57)) and found == list(range(0, 57, 7)), "0.15 s are 15 slots, and one more"


def test_what_is_larger_than_the_line_comes_in_pieces_whole_and_in_order() -> None:
    senders = ChangeSenders(True)
    receiver = ChangeReceiver(os.dup(senders.open("rig")))
    sent = [(3, change(1)), (4, change(2, size=1_000_000)), (9, change(3))]
    for k, each in sent:
        senders.put("rig", k, each)
        senders.put("no process of this name", k, each)
    senders.flush()
    assert list(receiver.due(2)) == [] and list(receiver.due(3)) == [(*sent[0], True)]
    came = []
    for _ in range(100):
        senders.flush()
        came += receiver.due(4)
    assert came == [(*sent[1], True)] and list(receiver.due(9)) == [(*sent[2], True)]
    senders.close()
    senders.flush()


def decided(changes: list[tuple[int, Change]], **asked: Any) -> list[bool]:
    """Return which changes act at a process that has come to slot 10."""
    senders = ChangeSenders(True)
    receiver = ChangeReceiver(os.dup(senders.open("rig")))
    for k, each in changes:
        senders.put("rig", k, each)
    senders.flush()
    found = [acts for _, _, acts in receiver.due(10, **asked)]
    senders.close()
    return found


def test_what_was_composed_upon_a_change_that_came_late_does_not_act_either() -> None:
    """It brought the late one with it, of which the log says that nothing was changed."""
    late, upon, knowing = change(1), change(2), structs.replace(change(3), era=1)
    end = Change(path=END, value=None, loop=None)
    sent = [(9, late), (10, upon), (10, knowing), (8, end)]
    assert decided(sent) == decided(sent, ahead=True) == [False, False, True, True]
    assert decided([(10, upon), (12, upon)], ahead=True) == [True, True] and decided([(10, upon), (12, upon)]) == [True]
    assert decided([(10, knowing), (10, upon)]) == [True, False], "a controller that was restarted learns it from what comes"


def test_a_session_takes_what_its_rig_took() -> None:
    sent = [(k, change(k)) for k in (0, 2, 5)]
    ahead = ChangeSchedule(lambda k: [each for at, each in sent if at == k], PERIOD_NS)
    assert list(ahead.at(0)) == sent and list(ahead.taken()) == []
    take = ahead.listeners()[EVENTS_TOPIC]
    for kind in (CHANGE, "late", LATE):
        take(0, encode_event(0, kind, "", slot=0, severity="info", data={}))
    assert list(ahead.taken()) == sent[:1] and list(ahead.undecided) == sent[2:]
    assert ChangeSchedule(None, PERIOD_NS).listeners() == {}


def test_a_process_that_takes_nothing_keeps_no_other_waiting() -> None:
    senders = ChangeSenders(True)
    senders.open("rig")
    for k in range(20):
        senders.put("rig", k, change(k, size=100_000))
        senders.flush()
    assert ChangeSenders(False).open("rig") == -1 and ChangeSenders(False).passed("rig", 5) == (5,)
    senders.close()
    assert list(ChangeReceiver(-1).due(10)) == []
