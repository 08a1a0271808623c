import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.pages.html.decimation import bucket_extremes


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
