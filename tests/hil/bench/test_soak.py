"""The soak measures growth where there is growth, and a session as it was."""

from __future__ import annotations

import numpy as np
import pytest

from hil.bench.soak import bench_soak, slope


def test_the_interval_covers_the_slope_as_often_as_it_says() -> None:
    """Binomial(400, 0.95): fewer than 365 or more than 394 with probability below 0.005, where the interval is right."""
    rng, t = np.random.default_rng(0), np.linspace(0.0, 10.0, 400)
    covered = 0
    for _ in range(400):
        estimate, half = slope(t, 2.0 * t + rng.normal(size=400))
        covered += abs(estimate - 2.0) <= half
    assert 365 <= covered <= 394


def test_a_leak_is_told_from_steps_that_end() -> None:
    rng, t = np.random.default_rng(1), np.linspace(0.0, 600.0, 400)
    noise = rng.normal(scale=20.0, size=400)
    leak, half = slope(t, 80_000 + 0.5 * t + noise)
    assert leak - half > 0
    flat, half = slope(t, 80_000 + noise)
    assert flat - half <= 0 <= flat + half


def test_too_few_samples_are_refused() -> None:
    with pytest.raises(ValueError, match="19 samples, expected 20 at least"):
        slope(np.arange(19.0), np.arange(19.0))


@pytest.mark.slow
@pytest.mark.realtime
def test_a_short_soak_measures_every_process_the_log_and_the_sessions() -> None:
    row = bench_soak(duration_s=5.0, sessions=1, at_once=2)
    assert row["ticks"] == 5000 or row["status"] != 0
    assert row["dropped"] == 0 and 0.5 < row["log_ratio"] < 2.0
    assert [each["process"] for each in row["memory"]] == ["session", "rig", "controller"]
    assert all(10 < each["mb"] < 1000 and each["plus_minus"] >= 0 for each in row["memory"])
    assert sum(row["in_a_row"].values()) == 1 and sum(row["at_once"].values()) == 2
    assert not {"1", "2"} & {*row["in_a_row"], *row["at_once"]}  # each ran to its end, whatever the machine made of its timing


def test_memory_that_stays_exactly_the_same_has_no_slope() -> None:
    t = np.cumsum(np.random.default_rng(0).uniform(1.0, 2.0, 293))
    for kb in (235_180.0, 201_080.0, 83_333.0):
        assert slope(t, np.full(293, kb)) == (0.0, 0.0)
