"""What a log recorded of the link is found slot by slot, in order or not, a stretch of it in memory."""

import tracemalloc
from collections.abc import Sequence

import numpy as np
import pytest

from hil.errors import HilError
from hil.log.read.run import Run
from hil.session.replay import recorded as replay_recorded
from hil.session.replay.recorded import RecordedAnswers, recorded_wire
from transport import SensorPacket, encode_sensor


def answers(slots: Sequence[int], late: Sequence[int] = ()) -> Run:
    found = np.empty(len(slots), [("t_ns", "<i8"), ("slot", "<i8"), ("late", "u1"), ("data", object)])
    found["slot"], found["late"] = slots, np.isin(np.arange(len(slots)), late)
    found["data"] = [b"%d at %d" % (k, i) for i, k in enumerate(slots)]
    return Run(arrays={"/link/control": found}, schemas={})


@pytest.mark.parametrize("slots", [[*range(5000)], [0, 1, 1, 4, 4, 9], [3, 1, 2, 2, 0, 7], []])
def test_the_last_answer_of_a_slot_that_came_in_time_is_received(slots: list[int]) -> None:
    late = [i for i in range(len(slots)) if i % 3 == 1]
    kept = {k: b"%d at %d" % (k, i) for i, k in enumerate(slots) if i not in late}
    received = RecordedAnswers(answers(slots, late))
    for end in (0, 2, 4, 4097, 10_000):
        assert received.answered(end) == sum(k < end for k in kept)
    assert [received.get(k) for k in range(5001)] == [kept.get(k) for k in range(5001)]


def test_answers_out_of_order_are_sorted_up_to_a_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(replay_recorded, "MOST_SORTED", 100)
    assert RecordedAnswers(answers([*range(1, 100), 0])).get(0) == b"0 at 99"
    assert RecordedAnswers(answers(range(5000))).answered(5000) == 5000  # in order: no limit
    assert RecordedAnswers(answers(range(-7, 200))).get(-7) == b"-7 at 0"  # so it is below slot 0
    with pytest.raises(HilError, match="/link/control: 101 packets that are out of order; hil sorts 100 at most"):
        RecordedAnswers(answers([*range(1, 101), 0]))


def test_asking_holds_no_more_for_a_longer_log() -> None:
    runs, held = [answers(range(n)) for n in (10_000, 40_000)], []
    for run in runs:
        tracemalloc.start()
        received = RecordedAnswers(run)
        assert received.answered(1 << 40) == len(run.arrays["/link/control"])
        held.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert held[1] - held[0] < 30_000  # a byte per slot; a column of slots has eight


@pytest.mark.parametrize("order", ["forwards", "backwards"])
def test_the_nonce_of_every_question_is_found(order: str) -> None:
    slots = np.arange(0, 9000, 2)[:: 1 if order == "forwards" else -1]
    questions = np.empty(len(slots), [("t_ns", "<i8"), ("slot", "<i8"), ("data", object)])
    questions["slot"] = slots
    questions["data"] = [encode_sensor(SensorPacket(int(k), 0, 0, (0.5,), nonce=int(k) + 7)) for k in slots]
    wire = recorded_wire(Run(arrays={"/link/sensor": questions}, schemas={}))
    assert [wire.nonce(k) for k in range(9010)] == [0 if k % 2 or k > 8998 else k + 7 for k in range(9010)]
    assert wire.nonce(4) == 11  # and one that was asked for before
