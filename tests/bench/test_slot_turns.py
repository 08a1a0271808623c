"""Two versions are measured in turns; one that fails says so."""

from __future__ import annotations

import io
import subprocess
from typing import Any

import pytest

from hil.errors import HilError
from tests.bench.slot_turns import least_us


def test_versions_are_measured_in_turns_and_the_least_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []
    answers = {"old": iter([1.0, 1.0, 9.0, 8.0, 7.0, 8.5]), "new": iter([1.0, 1.0, 5.0, 4.0, 6.0, 3.0])}

    class Started(io.BytesIO):
        def __init__(self, command: list[str], **_: Any) -> None:
            super().__init__()
            self.args, self.stdin, self.stdout = command, self, self
            self._name = "new" if "tests.bench.new" in command[-1] else "old"

        def readline(self, *_: Any) -> bytes:
            asked.append(self._name)
            return f"{next(answers[self._name])}\n".encode()

    monkeypatch.setattr(subprocess, "Popen", Started)
    found = least_us({"old": ("tests.bench.old", {}), "new": ("tests.bench.new", {})}, slots=10, turns=2)
    assert found == {"old": [7.0, 8.0], "new": [5.0, 3.0]}  # not the first turn, in which things are imported
    assert asked == ["old", "new"] * 6


def test_a_slot_takes_time_with_its_log_and_without() -> None:
    ((with_log, without),) = least_us({"ours": ("tests.bench.engines", {})}, slots=100, turns=1).values()
    assert with_log > 0.0 and without > 0.0


def test_a_version_that_cannot_be_measured_is_named() -> None:
    with pytest.raises(HilError, match="ended before it had measured a turn"):
        least_us({"ours": ("tests.bench.of_nobody", {})}, slots=1, turns=1)
