"""The benchmark of codes measures what it says."""

from __future__ import annotations

from tests.bench.auth import bench_auth


def test_every_packet_has_its_length_with_and_without_a_code_and_both_took_time() -> None:
    rows = bench_auth(number=20, turns=2)
    assert [(row["bytes"], row["bytes_keyed"]) for row in rows] == [(48, 48), (48, 64), (296, 304)]
    assert all(row["plain_us"] > 0 and row["keyed_us"] - row["plain_us"] == row["code_us"] for row in rows)
