"""Scheduled gains are solved once per machine; what the cache holds is data, never trust."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from design.controllers.scheduled_gain import ScheduledGain
from design.tracking.gain_cache import cached_gain, cached_history

GAIN = ScheduledGain(
    gain=np.array([[[[0.1, 1.0 / 3.0]], [[-2.0, 1e-17]]]]), starts_s=np.array([[0.0, 0.7]]), schedule="linear",
    measured=("eta", "r"),
)  # fmt: skip


def same(a: ScheduledGain, b: ScheduledGain) -> bool:
    return (
        a.gain.tobytes() == b.gain.tobytes() and a.starts_s.tobytes() == b.starts_s.tobytes()
        and (a.schedule, a.measured) == (b.schedule, b.measured)
    )  # fmt: skip


def refuse() -> ScheduledGain:
    raise AssertionError("it was solved again")


def test_the_same_request_is_solved_once_with_the_same_bits(tmp_path: Path) -> None:
    assert cached_gain(("a", np.ones(3)), lambda: GAIN, tmp_path) is GAIN
    assert same(cached_gain(("a", np.ones(3)), refuse, tmp_path), GAIN)
    with pytest.raises(AssertionError, match="solved again"):
        cached_gain(("a", np.nextafter(np.ones(3), 2.0)), refuse, tmp_path)


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"gain": [[1]], "starts_s": [], "schedule": "hold", "measured": []}'])
def test_a_damaged_entry_costs_the_time_of_solving(text: str, tmp_path: Path) -> None:
    cached_gain("a", lambda: GAIN, tmp_path)
    (entry,) = tmp_path.iterdir()
    entry.write_text(text)
    assert cached_gain("a", lambda: GAIN, tmp_path) is GAIN
    assert same(cached_gain("a", refuse, tmp_path), GAIN)


def test_what_cannot_be_named_is_solved_every_time(tmp_path: Path) -> None:
    assert cached_gain(lambda: 1, lambda: GAIN, tmp_path) is GAIN
    assert not list(tmp_path.iterdir())


def test_a_cache_that_cannot_be_written_is_no_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    assert cached_gain("a", lambda: GAIN, tmp_path / "file" / "below") is GAIN


@pytest.mark.parametrize("text", ["", "[]", '{"gains": [[1.0]]}', '{"gains": [[[[NaN]]]]}'])
def test_gains_over_historical_data_are_solved_once_and_again_where_their_entry_is_damaged(text: str, tmp_path: Path) -> None:
    K, solved = np.array([[[[0.1, 1.0 / 3.0]], [[-2.0, 1e-17]]]]), []

    def kept() -> np.ndarray:
        return cached_history(("a", np.ones(3)), lambda: solved.append(1) or K, tmp_path)

    assert kept().tobytes() == kept().tobytes() == K.tobytes() and len(solved) == 1
    (entry,) = tmp_path.iterdir()
    entry.write_text(text)
    assert kept().tobytes() == kept().tobytes() == K.tobytes() and len(solved) == 2
