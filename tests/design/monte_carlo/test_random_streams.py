"""Streams per run: addressed, disjoint, uniform. Seeds fixed, level 1e-3."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from design.monte_carlo.parallel_runs import JUMPS, NOISE, DrawTable, uniforms


def test_a_run_has_its_numbers_whatever_else_is_drawn() -> None:
    whole = uniforms(3, 0, 500, blocks=4, purpose=JUMPS, page=2)
    for first, runs in ((0, 1), (17, 40), (499, 1)):
        part = uniforms(3, first, runs, blocks=4, purpose=JUMPS, page=2)
        np.testing.assert_array_equal(part, whole[:, first : first + runs])


def test_pages_continue_a_stream() -> None:
    table = DrawTable(1, 10, 5, purpose=JUMPS, blocks=2)
    rows = np.stack([table.row(k) for k in range(20)])
    pages = [uniforms(1, 10, 5, blocks=2, purpose=JUMPS, page=p) for p in range(3)]
    np.testing.assert_array_equal(rows, np.concatenate(pages)[:20])


def test_no_two_streams_share_a_number_and_all_are_uniform() -> None:
    parts = [
        uniforms(seed, 0, 2000, blocks=4, purpose=purpose, page=page).ravel()
        for seed in (0, 1)
        for purpose in (JUMPS, NOISE)
        for page in (0, 1)
    ]
    every = np.concatenate(parts)
    # 256,000 draws of 52 bits: a coincidence has probability 7e-6.
    assert np.unique(every).size == every.size
    assert every.min() > 0.0
    assert every.max() < 1.0
    assert all(stats.kstest(part, "uniform").pvalue > 1e-3 / len(parts) for part in parts)


def test_consecutive_runs_are_uncorrelated() -> None:
    u = uniforms(9, 0, 20_000, blocks=1, purpose=JUMPS)
    for row in u:
        assert abs(np.corrcoef(row[:-1], row[1:])[0, 1]) < 4.0 / np.sqrt(20_000)


def test_bad_addresses_are_refused() -> None:
    with pytest.raises(ValueError, match=r"^seed: -1"):
        uniforms(-1, 0, 1, blocks=1, purpose=JUMPS)
    with pytest.raises(ValueError, match=r"^runs: "):
        uniforms(1, -1, 1, blocks=1, purpose=JUMPS)
