"""The bench of designs over many modes: every row has its peer, the same number from both, and the ratio of their times."""

from __future__ import annotations

import pytest

from tests.bench.modes import bench_certificates, bench_modes


def test_designs_have_a_norm_and_an_evaluation_beside_the_plain_one() -> None:
    rows = bench_modes(h2=(1, 2), hinf=(1,), large=3)
    assert [row["modes"] for row in rows] == [4, 9, 6, 4, 6]
    for row in rows:
        assert 0.0 < row["norm"] < 100.0
        assert row["ratio"] > 0.0 and row["evaluations"] > 0


def test_certificates_and_norms_agree_with_their_peers() -> None:
    rows = bench_certificates(side=4, orders=(4,))
    assert [(row["modes"], row["states"]) for row in rows] == [(16, 8), (1, 4), (1, 4)]
    for row in rows:
        assert row["value"] == pytest.approx(row["peer's value"], rel=1e-6)
        assert row["ratio"] > 0.0
