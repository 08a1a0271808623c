"""Arrays that grow in a file: the same rows, whatever was in memory and whatever the disk refused."""

import os
import tracemalloc

import numpy as np
import pytest

from hil.log import append_column
from hil.log.append_column import IN_MEMORY, AppendColumn, pieces, release, whole

ROW = np.dtype([("t_ns", "<i8"), ("value", "<f8"), ("late", "u1")])


def rows(n: int, seed: int = 0) -> np.ndarray:
    found = np.zeros(n, ROW)
    found["t_ns"], found["value"] = np.arange(n), np.random.default_rng(seed).standard_normal(n)
    return found


@pytest.mark.parametrize("n", [0, 1, 5_000, 2 * IN_MEMORY // ROW.itemsize + 17])
def test_what_was_added_is_what_is_there(n: int, tmp_path) -> None:
    expected, column = rows(n), AppendColumn(ROW, tmp_path)
    for start in range(0, n, 999):
        column.extend(expected[start : start + 999])
    assert len(column) == n
    array = column.array()
    del column  # the file is held by what is mapped
    assert array.dtype == ROW and array.tobytes() == expected.tobytes()
    release(array)
    assert np.concatenate([np.empty(0, ROW), *pieces(array, 1000)]).tobytes() == expected.tobytes()
    assert whole(array, "value").tobytes() == expected["value"].tobytes()
    assert not list(tmp_path.iterdir())


def test_a_long_array_is_no_memory_of_ours(tmp_path) -> None:
    column = AppendColumn(ROW, tmp_path)
    for seed in range(2 * IN_MEMORY // (1000 * ROW.itemsize)):
        column.extend(rows(1000, seed))
    array = column.array()
    assert not array.flags.owndata and not array.flags.writeable


def test_what_waits_for_the_file_is_little_from_the_beginning(tmp_path) -> None:
    """Each column waited for its first two megabytes, and grew until then."""
    column, most = AppendColumn(ROW, tmp_path), 0
    parts = [rows(300, seed) for seed in range(200)]
    tracemalloc.start()
    try:
        for part in parts:
            column.extend(part.copy())
            most = max(most, tracemalloc.get_traced_memory()[0])
    finally:
        tracemalloc.stop()
    assert most < 2 * append_column.PENDING and len(column) * ROW.itemsize > 8 * append_column.PENDING
    array = column.array()
    assert array.flags.writeable  # a short one is the caller's own
    assert array.tobytes() == np.concatenate(parts).tobytes()


def test_a_full_disk_costs_memory_and_not_the_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    expected, column = rows(3 * IN_MEMORY // ROW.itemsize), AppendColumn(ROW)
    write, room = os.pwrite, [2]

    def pwrite(*arguments) -> int:
        room[0] -= 1
        if room[0] < 0:
            raise OSError(28, "No space left on device")
        return write(*arguments)

    monkeypatch.setattr(append_column.os, "pwrite", pwrite)
    for start in range(0, len(expected), 5000):
        column.extend(expected[start : start + 5000])
    assert room[0] < 0
    assert column.array().tobytes() == expected.tobytes()


def test_a_folder_that_cannot_be_written_is_not_needed(tmp_path) -> None:
    column = AppendColumn(ROW, tmp_path / "gone")
    for _ in range(2):
        column.extend(rows(IN_MEMORY // ROW.itemsize + 1))
    assert len(column.array()) == 2 * (IN_MEMORY // ROW.itemsize + 1)
