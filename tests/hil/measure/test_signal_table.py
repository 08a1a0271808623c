"""A table of signals that another program wrote."""

from __future__ import annotations

import os
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from hil.errors import HilError
from hil.files import csv_columns
from hil.measure.identification_records import read_signal_table


def test_a_table_with_units_a_gap_and_an_empty_entry_is_read(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("\ufefft_s [s],u [V],y\n0.0,1,2\n0.1,,3\n0.2,6,7\n0.4,4,5\n")
    period_s, columns = read_signal_table(tmp_path / "t.csv", ("y", "u"))
    assert period_s == pytest.approx(0.1)
    np.testing.assert_array_equal(columns, [[2, 1], [3, np.nan], [7, 6], [np.nan, np.nan], [5, 4]])


def test_a_table_costs_little_more_memory_than_it_is_long(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text("t,u,y\n0,1,2\n1,2,3\n")
    read_signal_table(path, ("u", "y"))  # what the first one imports is no memory of a table
    path.write_text("t,u,y\n" + "".join(f"{k * 0.01:.2f},{k % 7}.125,{k % 11}.0625\n" for k in range(10_000)))
    tracemalloc.start()
    try:
        read_signal_table(path, ("u", "y"))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 8 * path.stat().st_size  # the whole text and a list of numbers for each line took 16 times


def test_what_is_no_regular_file_or_too_long_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "t.csv").write_text("t,y\n0,1\n1,2\n")
    monkeypatch.setattr(csv_columns, "MOST_BYTES", 5)
    refused = {"pipe": "is no regular file", "": "is a folder", "none": "cannot be read", "t.csv": "more than 5 bytes"}
    for name, said in refused.items():
        with pytest.raises(HilError, match=said):
            read_signal_table(tmp_path / name, ("y",))
