"""Recorded ages: what no file of ages is, is refused in bounded time and memory."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from transport.laws import trace
from transport.laws.trace import MAX_BYTES, read_ages


def test_a_pipe_is_not_waited_for_and_a_trace_has_an_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trace, "MAX_ENTRIES", 1000)  # two million take seconds to read
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(ValueError, match=r"^file: .*pipe is no regular file"):
        read_ages(tmp_path / "pipe")
    (tmp_path / "long").write_text("0\n" * 1001)
    with pytest.raises(ValueError, match=r"^file: .*long has more than 1000 entries"):
        read_ages(tmp_path / "long")
    (tmp_path / "large").write_text("0" * (MAX_BYTES + 1))
    with pytest.raises(ValueError, match=r"^file: .*large has more than"):
        read_ages(tmp_path / "large")
    for entry in ("9" * 5000, "x" * 5000):
        (tmp_path / "odd").write_text(f"0\n{entry}\n")
        with pytest.raises(ValueError, match=r"^file: .*odd: entry 1 is .*, expected a whole number") as caught:
            read_ages(tmp_path / "odd")
        assert len(str(caught.value)) < 1000
