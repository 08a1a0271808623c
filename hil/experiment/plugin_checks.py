"""What every controller and every network law must keep, as functions that its author can run.

Each raises AssertionError with a sentence. Plants have theirs in :mod:`plants.parts.check`, links in
:mod:`transport.links.contract`.
"""

from __future__ import annotations

import pickle
from typing import Any, cast

import msgspec
import numpy as np
from numpy.typing import NDArray

from design.controllers import (
    Controller,
    FromSamples,
    GainTable,
    HistoryGains,
    Known,
    LoopModel,
    ModeSchedule,
    Sample,
    SeveralSamples,
    integrates,
    packet_samples,
    row_count,
)
from transport.laws.delay_states import delay_states
from transport.laws.protocols import (
    AgeLaw,
    BoundedAge,
    BoundedTail,
    ChainLaw,
    ChannelLaw,
    NetworkLaw,
    RecordedLaw,
    SemiMarkovLaw,
    prepare,
    slots_served,
)
from transport.laws.statistics import law_p_value
from transport.medium.independent import impair

DIFFERS = 1e-6
"""A law whose record is this unlikely is not the one that was stated: one right law in a million is refused."""


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
    check_answers(controller, model)
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
    if isinstance(controller, HistoryGains):
        shape = controller.history().shape[2:]
        assert shape == (m, p), f"gains of shape {shape}, expected ({m}, {p})"
        said.append(f"{name} is a HistoryGains: its loop over scheduled nodes is certified where they measure the state")
    if len(said) == 1:
        said.append(f"{name} is neither a GainTable nor a ModeSchedule: its loop runs with allow_uncertified only")
    if isinstance(controller, SeveralSamples):
        said.append(f"{name} takes SeveralSamples: {packet_samples(controller)} in one sensor packet")
    return said


def check_answers(controller: Controller, model: LoopModel) -> None:
    """Check what a controller answers: right number of rows and inputs, finite, reproducible from a fresh start.

    Raises:
        AssertionError: naming the first rule that is broken.
    """
    m, p = model.B.shape[1], model.C.shape[0]
    seen = p * packet_samples(controller)

    def answers() -> list[Any]:
        rng = np.random.default_rng(3)
        running = controller.start(model)
        out = []
        for k in range(60):
            y = tuple(map(float, rng.normal(size=(seen,))))
            if isinstance(running, FromSamples):
                outputs = model.nodes.outputs
                newest = [Sample(i, k - (k + i) % len(outputs), tuple(y[o] for o in own)) for i, own in enumerate(outputs)]
                rows = running.rows(k, Known(tuple(s for s in newest if s.slot >= 0), (1.0,) * p))
            else:
                rows = running.rows(k, int(rng.integers(0, model.tau_max + 1)), y, (1.0,) * p)
            expected = row_count(running.selection, model.d_max)
            assert len(rows) == expected, f"{len(rows)} rows, expected {expected} for {running.selection!r}"
            assert all(len(row) == m for row in rows), f"a row has not {m} inputs"
            assert np.isfinite(rows).all(), "a row is not finite"
            out.append(rows)
        return out

    assert answers() == answers(), "a fresh start must give the same answers"


def check_law(law: NetworkLaw, slots: int = 400) -> list[str]:
    """Check a network law: reproducible, nothing from the future, ages within their bound, and drawn as it states.

    Returns:
        Which protocols of :mod:`transport.laws.protocols` the law fulfils and what each earns, a sentence each.

    Raises:
        AssertionError: naming the first rule that is broken.
    """
    assert msgspec.json.encode(law), "parameters must be plain data"
    law, name = prepare(law), type(law).__name__
    bound = law.max_age if isinstance(law, BoundedAge) else None

    def arrivals() -> list[list[int]]:
        impairment = impair(law, np.random.default_rng(5), 0.01, 0.006)
        out, newest = [], -1
        for k in range(slots):
            impairment.offer(k, k)
            draws, arrived = impairment.collect(k)
            assert all(d.tick == k for d in draws), "a draw is booked in another slot"
            assert all(packet == g <= k for g, packet in arrived), "a packet came from the future, or under another number"
            if bound is not None and arrived:
                newest = max(newest, *(g for g, _ in arrived))
                assert k - newest <= max(bound, k), "older than the law's bound"
            out.append([g for g, _ in arrived])
        return out

    assert arrivals() == arrivals(), "the same generator must give the same fates"
    if law.family == "packet":
        said = [f"{name} is a PerPacketLaw: it can run in a loop"]
        if isinstance(law, ChannelLaw):
            said.append(f"{name} is a ChannelLaw: its losses are analysed exactly, and every record is tested against it")
        return [*said, f"{name} is neither a ChainLaw nor a SemiMarkovLaw: loops over it run with allow_uncertified only"]
    said = [f"{name} is an AgeLaw: it can run in a loop"]
    modes = _check_drawn(cast(AgeLaw, law), slots)
    if isinstance(law, RecordedLaw):
        said.append(f"{name} is a RecordedLaw: its ages are analysed exactly, and every record is tested against it")
    elif isinstance(law, SemiMarkovLaw):
        said.append(f"{name} is a SemiMarkovLaw: loops over it, and stays in it, can be certified, designed for and predicted")
        silent = [i for i, sojourn in enumerate(law.sojourn) if not isinstance(sojourn, BoundedTail)]
        if silent:
            said.append(f"{name}: the sojourn laws of modes {silent} are no BoundedTail: nothing is assumed beyond the cut")
    elif isinstance(law, ChainLaw):
        said.append(f"{name} is a ChainLaw: loops over it can be certified, designed for and predicted")
    else:
        said.append(f"{name} is neither a ChainLaw nor a SemiMarkovLaw: loops over it run with allow_uncertified only")
    states = delay_states(law)
    if states is not None:
        p_value = law_p_value(law, modes)
        assert not p_value < DIFFERS, f"the drawn modes do not follow the stated chain: p = {p_value:.2g}"
        if states.has_gaps:
            said.append(f"{name}: the age may grow by more than one per slot; what runs is min(age, last + 1), certified so")
    return said


def _check_drawn(law: AgeLaw, slots: int) -> NDArray[np.int64]:
    """Return the modes of a run; every age must be a whole number within the bound, and that of its mode."""
    draw = law.start(np.random.default_rng(5)).draw
    served = slots_served(law)
    drawn = [draw() for _ in range(slots if served is None else min(slots, served))]
    bound = law.max_age
    assert all(0 <= age <= bound for _, age in drawn), f"an age outside 0 .. {bound}"
    if isinstance(law, ChainLaw | SemiMarkovLaw):
        ages = list(law.mode_ages)
        assert max(ages) <= bound, f"a mode has age {max(ages)}, above max_age {bound}"
        assert all(0 <= mode < len(ages) and age == ages[mode] for mode, age in drawn), "an age that is not its mode's"
    return np.array([mode for mode, _ in drawn], dtype=np.int64)
