"""The bench of the engines: every row has its peer and the ratio of the two."""

from __future__ import annotations

import pytest

from tests.bench import engines


def test_a_sweep_is_set_beside_the_plain_engine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engines, "SWEEPS", ("vtol-h2",))
    (row,) = engines.bench_sweep(runs=20, alone=1)
    assert row["slots"] == 500
    assert row["ratio"] == pytest.approx(row["run by run us"] / row["lockstep us per run"], rel=0.01)


def test_a_log_is_set_beside_mcaps_own_writer_and_has_its_bytes() -> None:
    (row,) = engines.bench_log(slots=1500, turns=1)
    assert row["same bytes"] is True
    assert row["ratio"] == pytest.approx(row["us"] / row["mcap's writer us"], rel=0.01)


def test_memory_of_an_open_log_is_set_beside_mcaps_own_writer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engines, "WARM_UP", 1)
    (row,) = engines.bench_memory(slots=(20, 140))  # within one chunk: both hold its messages
    assert row["bytes per slot"] > 50.0 and row["mcap's writer"] > 100.0
    assert row["ratio"] == pytest.approx(row["bytes per slot"] / row["mcap's writer"], rel=0.01)
