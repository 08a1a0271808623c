"""The columns of a topic of raw frames: the records that were taken, whole or in pieces."""

from __future__ import annotations

from struct import pack

import pytest

from hil.log.append_column import ROWS
from hil.log.read.columns import Columns
from hil.log.records import Field, Schema

RAW = Schema(name="hil/msg/Demo", fields=(Field(type="int64", name="number"), Field(type="uint8[]", name="data")))


@pytest.mark.parametrize("count", [0, 1, ROWS, ROWS + 1])
def test_all_records_stand_in_one_array_however_many_pieces_they_fill(count: int) -> None:
    columns = Columns(RAW, start_ns=5)
    columns.add([bytes(15) + pack("<q", n) + bytes(8) + RAW.pack(n, b"ab"[: n % 3]) for n in range(count)])
    columns.finish()
    found = columns.array()
    assert found["number"].tolist() == [*range(count)] and found["data"].tolist() == [b"ab"[: n % 3] for n in range(count)]
    assert found["t_ns"].tolist() == [n - 5 for n in range(count)]
