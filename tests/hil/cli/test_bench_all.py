"""``hil bench all``: what one part lacks, and an interrupt, lose nothing that was measured before."""

from __future__ import annotations

import json

import pytest

from hil.bench import engines
from hil.errors import HilError
from tests.hil.cli.conftest import Hil


def test_a_part_that_fails_is_named_and_an_interrupt_prints_what_was_found(cli: Hil, monkeypatch: pytest.MonkeyPatch) -> None:
    def lacking(*args: object) -> None:
        raise HilError("no disk")

    def interrupted(*args: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(engines, "bench_sweep", lambda *args: [{"ratio": 2.0}])
    monkeypatch.setattr(engines, "bench_log", lacking)
    monkeypatch.setattr(engines, "bench_memory", interrupted)
    status, out, _ = cli("bench", "all", "--json")
    found = json.loads(out)
    assert status == 130
    assert found["sweep"] == [{"ratio": 2.0}]
    assert found["not_measured"]["log"] == "no disk" and found["not_measured"]["memory"] == "interrupted"
    assert "links" not in found
