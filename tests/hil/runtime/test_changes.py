"""Changes on their way to a run in real time: once each, in order, without a wait."""

from __future__ import annotations

import os

from hil.runtime.changes import Change, ChangeReceiver, ChangeSchedule, ChangeSenders

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
    assert list(receiver.due(2)) == [] and list(receiver.due(3)) == sent[:1]
    came = []
    for _ in range(100):
        senders.flush()
        came += receiver.due(8)
    assert came == sent[1:2] and list(receiver.due(9)) == sent[2:]
    senders.close()
    senders.flush()


def test_a_process_that_takes_nothing_keeps_no_other_waiting() -> None:
    senders = ChangeSenders(True)
    senders.open("rig")
    for k in range(20):
        senders.put("rig", k, change(k, size=100_000))
        senders.flush()
    assert ChangeSenders(False).open("rig") == -1 and ChangeSenders(False).passed("rig", 5) == (5,)
    senders.close()
    assert list(ChangeReceiver(-1).due(10)) == []
