"""Frames come out in the order of time, whatever the order of the log, and few of them wait in memory."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from hil.errors import HilError
from hil.log.read import can_log as module
from hil.log.read.can_log import measured_frames
from hil.log.run import Arrays, Run

MS = 1_000_000


def run_of(slots: Sequence[int], late_us: float = 0.0, timed: Sequence[int] = ()) -> Run:
    """Answers of slots in the order of the log; a slot of an odd number was timed late; `timed`: the order of the timings."""
    answers = np.empty(len(slots), [("t_ns", "<i8"), ("slot", "<i8"), ("data", object)])
    answers["slot"], answers["t_ns"] = slots, np.array(slots) * MS
    answers["data"] = [k.to_bytes(4, "little") for k in slots]
    timing = np.zeros(len(slots), [("lateness_us", "<f8"), ("round_trip_us", "<f8"), ("slot", "<i8")])
    timing["slot"] = timed or np.sort(slots)
    timing["lateness_us"] = np.where(timing["slot"] % 2, late_us, 0.0)
    return Run(arrays={"/link/control": answers, "/timing/slot": timing}, schemas={})


def slots_of(run: Run) -> list[int]:
    return [int.from_bytes(data, "little") for _, data in measured_frames(run, "/link/control")]


@pytest.mark.parametrize("late_us", [0.0, 1700.0])
def test_frames_stand_in_the_order_of_time(late_us: float) -> None:
    rng = np.random.default_rng(0)
    slots = [int(k) for start in range(0, 9000, 30) for k in rng.permutation(np.arange(start, start + 30))]
    found = [*measured_frames(run_of(slots, late_us), "/link/control")]
    expected = sorted((k * MS + (k % 2) * int(late_us * 1000), k.to_bytes(4, "little")) for k in slots)
    assert found == expected


@pytest.mark.parametrize("timed", [(2, 3, 0, 1), (0, 1, 3, 2), (3, 2, 1, 0)])
def test_timings_in_any_order_are_those_of_their_slots(timed: tuple[int, ...]) -> None:
    found = [t for t, _ in measured_frames(run_of(range(4), 300.0, timed), "/link/control")]
    assert found == [0, MS + 300_000, 2 * MS, 3 * MS + 300_000]


def test_few_frames_wait_for_one_that_came_late(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MOST_HELD", 8)
    slots = [0, 1, 3, 2, 4, 5, 7, 6, *range(8, 20_000)]
    assert slots_of(run_of(slots)) == sorted(slots)
    with pytest.raises(HilError, match=r"/link/control: the frames are out of order by 0\.05 s; more than 8 would have to wait"):
        slots_of(run_of([*range(1, 52), 1, *range(52, 200)]))


def test_a_piece_at_a_time_is_read() -> None:
    class Counted(Arrays):
        alive = 0

        def pieces(self, topic: str, rows: int) -> Iterator[Any]:
            for piece in super().pieces(topic, rows):
                self.alive = len(piece)
                yield piece

    run = run_of(range(10_000))
    arrays = Counted(run.arrays)
    first, _ = next(measured_frames(replace(run, arrays=arrays), "/link/control"))
    assert first == 0 and 0 < arrays.alive < 10_000
