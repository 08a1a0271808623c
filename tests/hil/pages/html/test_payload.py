"""Fewer points, same picture; a curve that is read in blocks keeps the points that it keeps in one piece."""

from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.pages.html.payload import bucket_extremes, reduced

WHOLE, BUCKETS, N = 80, 12, 400


@pytest.mark.parametrize("step", [False, True])
@pytest.mark.parametrize("block", [1, 7, 100, N])
@pytest.mark.parametrize("kind", ["noise", "gaps", "held", "one value"])
def test_points_do_not_depend_on_the_blocks(kind: str, block: int, step: bool) -> None:
    rng = np.random.default_rng(3)
    x, y = np.cumsum(rng.uniform(0.5, 1.5, N)), rng.standard_normal(N)
    if kind == "gaps":
        y[rng.uniform(size=N) < 0.3] = np.nan
        y[200:240] = np.inf  # drawn as a gap
    elif kind == "held":
        y = np.repeat(rng.integers(0, 3, N // 50), 50).astype(float)
    elif kind == "one value":
        y[:] = 1.0

    def blocks() -> Iterator[tuple[np.ndarray, np.ndarray]]:
        for i in range(0, N, block):
            yield x[i : i + block], y[i : i + block]

    drawn = np.where(np.isfinite(y), y, np.nan)
    chosen = held_ends(drawn) if step else np.arange(N)
    keep = chosen if chosen.size <= WHOLE else chosen[bucket_extremes(x[chosen], drawn[chosen], BUCKETS)]
    found_x, found_y, samples = reduced(blocks, step=step, whole=WHOLE, buckets=BUCKETS)
    assert samples == N
    np.testing.assert_array_equal(found_x, x[keep])
    np.testing.assert_array_equal(found_y, drawn[keep])


def held_ends(y: np.ndarray) -> np.ndarray:
    told = np.where(np.isnan(y), np.inf, y)
    return np.flatnonzero(np.concatenate(([True], told[1:] != told[:-1])) | (np.arange(y.size) == y.size - 1))


def test_step_curve_keeps_its_changes_and_nothing_else() -> None:
    y = np.repeat([0.0, 1.0, np.nan, 2.0], 250)
    assert reduced(lambda: iter([(np.arange(1000.0), y)]), step=True)[0].tolist() == [0, 250, 500, 750, 999]


def test_a_curve_without_an_end_is_kept_whole() -> None:
    x = np.append(np.arange(500.0), np.inf)
    assert reduced(lambda: iter([(x, x)]), step=False, whole=400, buckets=60)[0].size == 501


def test_nothing_is_reduced_to_nothing() -> None:
    assert [len(part) for part in reduced(lambda: iter(()), step=True)[:2]] == [0, 0]


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 3000), st.integers(1, 50))
def test_decimated_curve_keeps_the_envelope_of_every_bucket(seed: int, n: int, buckets: int) -> None:
    rng = np.random.default_rng(seed)
    x = np.sort(rng.uniform(0.0, 10.0, n))
    y = rng.standard_t(1.5, n)
    keep = bucket_extremes(x, y, buckets)
    assert keep.size <= max(5 * buckets, n if n <= 4 * buckets else 0)
    assert np.all(np.diff(keep) > 0)
    assert y[keep].min() == y.min() and y[keep].max() == y.max()
    edges = np.linspace(x[0], x[-1], buckets + 1)
    inside = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, buckets - 1)
    kept = np.clip(np.searchsorted(edges, x[keep], side="right") - 1, 0, buckets - 1)
    clear = np.min(np.abs(x[:, None] - edges[None, 1:-1]), axis=1, initial=np.inf) > 1e-9
    if clear.all():
        for b in np.unique(inside):
            assert y[keep][kept == b].min() == y[inside == b].min()
            assert y[keep][kept == b].max() == y[inside == b].max()


def test_gap_survives_decimation() -> None:
    y = np.zeros(100_000)
    y[5_000:5_010] = np.nan
    keep = bucket_extremes(np.arange(y.size, dtype=float), y, 100)
    assert np.isnan(y[keep]).any()
    assert keep.size < 600


def test_equal_instants_are_all_kept() -> None:
    assert bucket_extremes(np.full(5000, 2.0), np.arange(5000.0), 10).size == 5000
