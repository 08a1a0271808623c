"""What every controller must keep, as functions that its author can run; each raises AssertionError with a sentence.

Network laws have theirs in :mod:`hil.plugins.law_checks`, measures in :mod:`hil.measure.check`, plants in
:mod:`plants.parts.check`, links in :mod:`transport.links.contract`.
"""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np

from design.controllers import (
    Controller,
    GainTable,
    HistoryGains,
    Known,
    LoopModel,
    ModeSchedule,
    MultiSampleController,
    Sample,
    SeveralSamples,
    integrates,
    packet_samples,
    row_count,
)
from hil.plugins.asked import asked, needs
from hil.plugins.law_checks import check_law
from transport.packets import SELECTIONS

__all__ = ["check_answers", "check_controller", "check_law", "check_table"]

RUNNING = {"selection": f"which row is applied: one of {', '.join(SELECTIONS)}", "rows": "a method that gives the rows of a slot"}


def check_controller(controller: Controller, model: LoopModel) -> list[str]:
    """Check a controller: right number of rows and inputs, finite, reproducible from a fresh start.

    Returns:
        Which protocols of :mod:`design.controllers` the controller fulfils and what each earns, a sentence each.

    Raises:
        AssertionError: naming the first rule that is broken.
    """
    name = type(controller).__name__
    needs(controller, f"{name}, a controller,", {"start": "a method that returns the running controller"})
    m, p = model.B.shape[1], model.C.shape[0]
    again = asked("pickle", lambda: pickle.loads(pickle.dumps(controller)))
    assert again == controller, f"the parameters of {name} must survive pickling, for the controller is another process"
    check_answers(controller, model)
    said = [f"{name} is a Controller: it can run in a loop"]
    if isinstance(controller, GainTable):
        check_table(controller, model)
        said.append(f"{name} is a GainTable: its loop over delay chains is certified exactly, and its error is predicted")
    if isinstance(controller, ModeSchedule):
        shape = controller.schedule_of_modes().gain.shape[2:]
        assert shape == (m, p - 1), f"gains of shape {shape}, expected ({m}, {p - 1}): the state without the mode"
        said.append(f"{name} is a ModeSchedule: its loop over a JumpPlant is judged at the period that it runs with")
    if isinstance(controller, HistoryGains):
        shape = controller.history().shape[2:]
        assert shape == (m, p), f"gains of shape {shape}, expected ({m}, {p})"
        said.append(f"{name} is a HistoryGains: its loop over scheduled nodes is certified where they measure the state")
    if len(said) == 1:
        said.append(f"{name} is neither a GainTable nor a ModeSchedule: its loop runs with allow_uncertified only")
    if isinstance(controller, SeveralSamples):
        said.append(f"{name} takes SeveralSamples: {packet_samples(controller)} in one sensor packet")
    return said


def check_table(controller: GainTable, model: LoopModel) -> None:
    """Check the table of gains of a controller: four axes, a row for every delay, finite.

    Raises:
        AssertionError: naming the first rule that is broken.
    """
    m, p = model.B.shape[1], model.C.shape[0]
    table = asked("table(model)", lambda: np.asarray(controller.table(model), dtype=float))
    rows = row_count(controller.selection, model.d_max)
    width = p * packet_samples(controller) + p * integrates(controller)
    fits = table.ndim == 4 and len(table) > 0 and table.shape[1:] == (rows, m, width)
    assert fits, f"table(model) of shape {table.shape}, expected (tau, {rows}, {m}, {width}), tau up to {model.tau_max}"
    assert np.isfinite(table).all(), "table(model): a gain is not finite"


def check_answers(controller: Controller, model: LoopModel) -> None:
    """Check what a controller answers: right number of rows and inputs, finite, reproducible from a fresh start.

    Raises:
        AssertionError: naming the first rule that is broken.
    """
    m, p = model.B.shape[1], model.C.shape[0]
    seen = p * packet_samples(controller)

    def answers() -> list[Any]:
        rng = np.random.default_rng(3)
        running = asked("start(model)", controller.start, model)
        needs(running, "what start(model) returns", RUNNING)
        chosen = running.selection
        assert chosen in SELECTIONS, f"selection is {chosen!r:.60}, expected one of {', '.join(SELECTIONS)}"
        out = []
        for k in range(60):
            y = tuple(map(float, rng.normal(size=(seen,))))
            if isinstance(running, MultiSampleController):
                outputs = model.nodes.outputs
                newest = [Sample(i, k - (k + i) % len(outputs), tuple(y[o] for o in own)) for i, own in enumerate(outputs)]
                known = Known(tuple(s for s in newest if s.slot >= 0), (1.0,) * p)
                rows = asked("rows(k, known)", running.rows, k, known)
            else:
                tau = int(rng.integers(0, model.tau_max + 1))
                rows = asked("rows(k, tau, y, r)", running.rows, k, tau, y, (1.0,) * p)
            expected = row_count(running.selection, model.d_max)
            numbers = asked(f"rows() returned {rows!r:.80}", lambda rows=rows: [[float(u) for u in row] for row in rows])
            assert len(numbers) == expected, f"{len(numbers)} rows, expected {expected} for {running.selection!r}"
            assert all(len(row) == m for row in numbers), f"a row has not {m} inputs"
            assert np.isfinite(numbers).all(), "a row is not finite"
            out.append(numbers)
        return out

    assert answers() == answers(), "a fresh start must give the same answers"
