"""What every controller and every network law must keep, as functions that its author can run.

Each raises AssertionError with a sentence. Plants have theirs in :mod:`plants.parts.check`, links in
:mod:`transport.links.contract`.
"""

from __future__ import annotations

import pickle
from typing import Any

import msgspec
import numpy as np

from design.controllers import LoopModel, packet_samples, row_count
from transport.medium.independent import impair


def check_controller(controller: Any, model: LoopModel) -> None:
    """Check a controller: right number of rows and inputs, finite, reproducible from a fresh start."""
    m, p = model.B.shape[1], model.C.shape[0]
    seen = p * packet_samples(controller)
    assert pickle.loads(pickle.dumps(controller)) == controller, "parameters must survive pickling"

    def answers() -> list[Any]:
        rng = np.random.default_rng(3)
        running = controller.start(model)
        out = []
        for k in range(60):
            y = tuple(map(float, rng.normal(size=(seen,))))
            rows = running.rows(k, int(rng.integers(0, model.tau_max + 1)), y, (1.0,) * p)
            expected = row_count(running.selection, model.d_max)
            assert len(rows) == expected, f"{len(rows)} rows, expected {expected} for {running.selection!r}"
            assert all(len(row) == m for row in rows), f"a row has not {m} inputs"
            assert np.isfinite(rows).all(), "a row is not finite"
            out.append(rows)
        return out

    assert answers() == answers(), "a fresh start must give the same answers"


def check_law(law: Any, slots: int = 400) -> None:
    """Check a network law: reproducible, nothing from the future, ages within their bound and growing by one at most."""
    assert msgspec.json.encode(law), "parameters must be plain data"

    def arrivals() -> list[list[int]]:
        impairment = impair(law, np.random.default_rng(5), 0.01, 0.006)
        out, newest = [], -1
        for k in range(slots):
            impairment.offer(k, k)
            draws, arrived = impairment.collect(k)
            assert all(d.tick == k for d in draws), "a draw is booked in another slot"
            assert all(packet == g <= k for g, packet in arrived), "a packet came from the future, or under another number"
            if getattr(law, "max_age", None) is not None and arrived:
                newest = max(g for g, _ in arrived)
                assert k - newest <= max(law.max_age, k), "older than the law's bound"
            out.append([g for g, _ in arrived])
        return out

    assert arrivals() == arrivals(), "the same generator must give the same fates"
