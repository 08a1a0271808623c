"""What every controller and every network law must keep, as functions that its author can run.

Each raises AssertionError with a sentence. Plants have theirs in :mod:`plants.parts.check`, links in
:mod:`transport.links.contract`.
"""

from __future__ import annotations

import pickle
from typing import Any

import msgspec
import numpy as np

from design.controllers import (
    Controller,
    GainTable,
    LoopModel,
    ModeSchedule,
    SeveralSamples,
    integrates,
    packet_samples,
    row_count,
)
from transport.medium.independent import impair


def check_controller(controller: Controller, model: LoopModel) -> list[str]:
    """Check a controller: right number of rows and inputs, finite, reproducible from a fresh start.

    Returns:
        Which protocols of :mod:`design.controllers` the controller fulfils and what each earns, a sentence each.

    Raises:
        AssertionError: naming the first rule that is broken.
    """
    name = type(controller).__name__
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
    said = [f"{name} is a Controller: it can run in a loop"]
    if isinstance(controller, GainTable):
        table = np.asarray(controller.table(model))
        rows = row_count(controller.selection, model.d_max)
        width = seen + p * integrates(controller)
        fits = table.ndim == 4 and table.shape[1:] == (rows, m, width)
        assert fits, f"table of shape {table.shape}, expected (tau, {rows}, {m}, {width})"
        assert np.isfinite(table).all(), "a gain is not finite"
        said.append(f"{name} is a GainTable: its loop over delay chains is certified exactly, and its error is predicted")
    if isinstance(controller, ModeSchedule):
        shape = controller.schedule_of_modes().gain.shape[2:]
        assert shape == (m, p - 1), f"gains of shape {shape}, expected ({m}, {p - 1}): the state without the mode"
        said.append(f"{name} is a ModeSchedule: its loop over a JumpPlant is judged at the period that it runs with")
    if len(said) == 1:
        said.append(f"{name} is neither a GainTable nor a ModeSchedule: its loop runs with allow_uncertified only")
    if isinstance(controller, SeveralSamples):
        said.append(f"{name} takes SeveralSamples: {packet_samples(controller)} in one sensor packet")
    return said


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
