"""What every controller and every network law must keep, as functions that its author can run: `check_controller`, `check_law`.

Each raises AssertionError with a sentence. Measures have theirs in :mod:`hil.measure.check`, plants in :mod:`plants.parts.check`,
links in :mod:`transport.links.contract`.
"""

from __future__ import annotations

import dataclasses
import pickle
from numbers import Integral
from typing import Any, Final, cast

import msgspec
import numpy as np
from numpy.typing import NDArray

from design.controllers import (
    AgedFeedback,
    Controller,
    GainTable,
    HistoryGains,
    Known,
    LinearFeedback,
    LinearLaw,
    LoopModel,
    ModeSchedule,
    MultiSampleController,
    RowsLaw,
    Sample,
    SeveralSamples,
    controller_traits,
    row_count,
)
from design.controllers.scheduled_gain import ScheduledGain
from hil.plugins.user_plugins import asked, needs
from transport import laws
from transport.draws import Draw
from transport.law_tests import law_p_value
from transport.laws.delay_states import delay_states
from transport.medium.independent import impair
from transport.packets import SELECTIONS

DIFFERS: Final = 1e-6
"""A law whose record is this unlikely is not the one that was stated: one right law in a million is refused."""

LAW: Final = {
    "family": '"age" for ages in slots, "packet" for a latency of every packet',
    "start": "a method that returns the running law",
}
AGE: Final = {"max_age": "the largest age in slots that draw() returns, a whole number"}
PACKET: Final = {"reordering": "whether a packet may overtake an earlier one", "queue": "the largest number of packets in flight"}
PERIOD_S, DEADLINE_S, SLOTS = 0.01, 0.006, 400


def check_law(law: laws.NetworkLaw) -> list[str]:
    """Check a network law: reproducible, nothing from the future, ages within their bound, and drawn as it states.

    Returns:
        Which protocols of :mod:`transport.laws` the law fulfils and what each earns, a sentence each.

    Raises:
        AssertionError: naming the first rule that is broken, in the words of the law's author.
    """
    name = type(law).__name__
    needs(law, f"{name}, a network law,", LAW)
    assert law.family in ("age", "packet"), f'{name}.family is {law.family!r:.60}, expected "age" or "packet"'
    needs(law, f'{name}, a network law of family "{law.family}",', AGE if law.family == "age" else PACKET)
    if dataclasses.is_dataclass(law) or isinstance(law, msgspec.Struct):
        asked(f"the fields of {name} must be plain data", msgspec.json.encode, law)
    law = laws.prepare(law)
    check_draws(law)
    bound = law.max_age if isinstance(law, laws.BoundedAge) else None

    def arrivals() -> list[list[int]]:
        impairment = impair(law, np.random.default_rng(5), PERIOD_S, DEADLINE_S)
        out, newest = [], -1
        for k in range(SLOTS):
            impairment.offer(k, k)
            draws, arrived = asked(f"draw() of slot {k}", impairment.collect, k)
            assert all(d.slot == k for d in draws), "a draw is booked in another slot"
            assert all(packet == g <= k for g, packet in arrived), "a packet came from the future, or under another number"
            if bound is not None and arrived:
                newest = max(newest, *(g for g, _ in arrived))
                assert k - newest <= max(bound, k), "older than the law's bound"
            out.append([g for g, _ in arrived])
        return out

    assert arrivals() == arrivals(), f"{name}.start(rng): two starts with one seed must draw the same; draw from rng alone"
    if law.family == "packet":
        said = [f"{name} is a PerPacketLaw: it can run in a loop"]
        if isinstance(law, laws.ChannelLaw):
            said.append(f"{name} is a ChannelLaw: its losses are analysed exactly, and every record is tested against it")
        return [*said, f"{name} is neither a ChainLaw nor a SemiMarkovLaw: loops over it run with allow_uncertified only"]
    said = [f"{name} is an AgeLaw: it can run in a loop"]
    modes = _check_drawn(cast(laws.AgeLaw, law))
    if isinstance(law, laws.RecordedLaw):
        said.append(f"{name} is a RecordedLaw: its ages are analysed exactly, and every record is tested against it")
    elif isinstance(law, laws.SemiMarkovLaw):
        said.append(f"{name} is a SemiMarkovLaw: loops over it, and stays in it, can be certified, designed for and predicted")
        silent = [i for i, sojourn in enumerate(law.sojourn) if not isinstance(sojourn, laws.BoundedTail)]
        if silent:
            said.append(f"{name}: the sojourn laws of modes {silent} are no BoundedTail: nothing is assumed beyond the cut")
    elif isinstance(law, laws.ChainLaw):
        _check_chain(law)
        said.append(f"{name} is a ChainLaw: loops over it can be certified, designed for and predicted")
    else:
        said.append(
            f"{name} is neither a ChainLaw (transition_matrix() and mode_ages) nor a SemiMarkovLaw: "
            "loops over it run with allow_uncertified only"
        )
    states = asked("transition_matrix() and mode_ages", delay_states, law)
    if states is not None:
        p_value = asked("transition_matrix() and mode_ages", law_p_value, law, modes)
        assert not p_value < DIFFERS, f"the drawn modes do not follow the stated chain: p = {p_value:.2g}"
        again = float((states.matrix**2).sum(axis=1).max()) ** (len(modes) - 1)  # at most: that two runs draw the same
        random = again > DIFFERS or not np.array_equal(modes, _check_drawn(cast(laws.AgeLaw, law), seed=6))
        assert random, f"{name}.start(rng): two starts with two seeds draw the same modes; draw from rng alone"
        if states.has_gaps:
            said.append(f"{name}: the age may grow by more than one per slot; what runs is min(age, last + 1), certified so")
    return said


def check_draws(law: Any) -> None:
    """Check what `start` and `draw` return, shape by shape, before anything leans on it.

    Raises:
        AssertionError: naming what is missing or has another shape.
    """
    rng, name = np.random.default_rng(5), type(law).__name__
    packet = law.family == "packet"
    call = "start(rng, period_s, deadline_s)" if packet else "start(rng)"
    running = asked(f"{name}.{call}", law.start, rng, *((PERIOD_S, DEADLINE_S) if packet else ()))
    if packet:
        needs(running, f"what {call} returns", {"draw": "draw(k) gives a list of Draw for the packet of slot k"})
        drawn = asked("draw(0)", running.draw, 0)
        right = isinstance(drawn, list) and bool(drawn) and all(isinstance(d, Draw) for d in drawn)
        assert right, f"draw(k) returned {drawn!r:.80}, expected a list of transport.Draw"
        return
    bound = law.max_age
    assert _whole(bound) and bound >= 0, f"{name}.max_age is {bound!r:.60}, expected a whole number of slots"
    needs(running, f"what {call} returns", {"draw": "draw() gives (mode, age) of the next slot"})
    drawn = asked("draw()", running.draw)
    pair = isinstance(drawn, tuple) and len(drawn) == 2 and all(map(_whole, drawn))
    assert pair, f"draw() returned {drawn!r:.80}, expected (mode, age), two whole numbers"


def _check_chain(law: laws.ChainLaw) -> None:
    matrix, n = asked("transition_matrix()", lambda: np.asarray(law.transition_matrix(), dtype=float)), len(law.mode_ages)
    assert matrix.shape == (n, n), f"transition_matrix() of shape {matrix.shape}, expected {(n, n)}: mode_ages has {n} modes"
    for i, row in enumerate(matrix):
        assert bool((row >= 0).all()), f"transition_matrix(): row {i} has a probability below 0 or none"
        assert abs(row.sum() - 1.0) < 1e-9, f"transition_matrix(): row {i} sums to {row.sum():g}, expected 1"


def _whole(value: object) -> bool:
    return isinstance(value, Integral) and not isinstance(value, bool)


def _check_drawn(law: laws.AgeLaw, seed: int = 5) -> NDArray[np.int64]:
    """Return the modes of a run; every age must be a whole number within the bound, and that of its mode."""
    draw = law.start(np.random.default_rng(seed)).draw
    served = laws.slots_served(law)
    drawn = [draw() for _ in range(SLOTS if served is None else min(SLOTS, served))]
    bound, ages = law.max_age, list[int]()
    if isinstance(law, laws.ChainLaw | laws.SemiMarkovLaw):
        ages = asked("mode_ages", lambda: list(law.mode_ages))
        right = bool(ages) and all(map(_whole, ages))
        assert right, f"mode_ages is {law.mode_ages!r:.60}, expected the age of every mode, whole numbers"
    assert all(0 <= age <= bound for _, age in drawn), f"draw() gave an age outside 0 .. {bound}, which max_age allows"
    if ages:
        assert max(ages) <= bound, f"a mode has age {max(ages)}, above max_age {bound}"
        assert all(0 <= mode < len(ages) and age == ages[mode] for mode, age in drawn), "an age that is not its mode's"
    return np.array([mode for mode, _ in drawn], dtype=np.int64)


RUNNING = {
    "selection": f'which row of the packet is applied: "constant" where it has one, else one of {", ".join(SELECTIONS[1:])}',
    "rows": "a method that gives the rows of a slot",
}


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
    check_statements(controller, model)
    said = [f"{name} is a Controller: it can run in a loop"]
    if isinstance(controller, GainTable):
        check_table(controller, model)
        said.append(f"{name} is a GainTable: its loop over delay chains is certified exactly, and its error is predicted")
    if isinstance(controller, LinearFeedback | AgedFeedback):
        kind = "LinearFeedback" if isinstance(controller, LinearFeedback) else "AgedFeedback"
        said.append(f"{name} is a {kind}: linear with states of its own, and its loop over delay chains is certified")
    if isinstance(controller, ModeSchedule):
        shape = controller.schedule_of_modes().gain.shape[2:]
        assert shape == (m, p - 1), f"gains of shape {shape}, expected ({m}, {p - 1}): the state without the mode"
        said.append(f"{name} is a ModeSchedule: its loop over a JumpPlant is judged at the period that it runs with")
    if isinstance(controller, HistoryGains):
        shape = controller.history().shape[2:]
        assert shape == (m, p), f"gains of shape {shape}, expected ({m}, {p})"
        said.append(f"{name} is a HistoryGains: its loop over scheduled nodes is certified where they measure the state")
    if len(said) == 1:
        said.append(
            f"{name} states no gains or matrices: its loop runs with allow_uncertified only. State table(model) of a gain "
            'without a state, linear_law(model) of an observer, or take kind = "output-feedback" with its A, B, C, D'
        )
    if isinstance(controller, SeveralSamples):
        said.append(f"{name} takes SeveralSamples: {controller_traits(controller).samples} in one sensor packet")
    return said


def check_table(controller: GainTable, model: LoopModel) -> None:
    """Check the table of gains of a controller: four axes, a row for every delay, finite.

    Raises:
        AssertionError: naming the first rule that is broken.
    """
    m, p = model.B.shape[1], model.C.shape[0]
    table = asked("table(model)", lambda: np.asarray(controller.table(model), dtype=float))
    its = controller_traits(controller)
    rows = row_count(controller.selection, model.d_max, its.row_sojourns)
    width = p * its.samples + p * its.integrates + its.order
    fits = table.ndim == 4 and len(table) > 0 and table.shape[1:] == (rows, m, width)
    assert fits, f"table(model) of shape {table.shape}, expected (tau, {rows}, {m}, {width}), tau up to {model.tau_max}"
    assert np.isfinite(table).all(), "table(model): a gain is not finite"
    if its.state_gains:
        own = asked("state_gains", lambda: np.asarray(its.state_gains, dtype=float))
        expected = (len(table), its.order, width)
        assert own.shape == expected, f"state_gains of shape {own.shape}, expected {expected}"
        assert np.isfinite(own).all(), "state_gains: a gain is not finite"


def check_statements(controller: Controller, model: LoopModel) -> None:
    """Check what a controller states of itself beside a table: what it returns is of the kind that is asked for.

    Raises:
        AssertionError: naming the first rule that is broken.
    """
    its = asked("samples, row_sojourns, integral_limit or ages", controller_traits, controller)
    assert its.samples >= 1, f"samples is {its.samples}, expected a whole number of at least 1"
    stays, rule = its.row_sojourns, controller.start(model).selection
    assert stays == 1 or (stays > 1 and rule == "applied"), f"row_sojourns is {stays}, with the rule {rule!r} expected 1"
    for states, name, arguments, kind in (
        (LinearFeedback, "linear_law", (model,), LinearLaw), (ModeSchedule, "schedule_of_modes", (), ScheduledGain),
        (HistoryGains, "history", (), np.ndarray),
    ):  # fmt: skip
        if isinstance(controller, states):
            said = f"{name}({'model' if arguments else ''})"
            found = asked(said, getattr(controller, name), *arguments)
            assert isinstance(found, kind), f"{said} returned {found!r:.60}, expected a {kind.__name__}"
    if isinstance(controller, AgedFeedback):
        laws = asked("laws_of_ages(model, ages)", controller.laws_of_ages, model, model.tau_max + 1)
        alike = isinstance(laws, tuple) and len(laws) == model.tau_max + 1 and all(isinstance(law, RowsLaw) for law in laws)
        assert alike, f"laws_of_ages(model, {model.tau_max + 1}) returned {laws!r:.60}, expected so many RowsLaw in a tuple"


def check_answers(controller: Controller, model: LoopModel) -> None:
    """Check what a controller answers: right number of rows and inputs, finite, reproducible from a fresh start.

    Raises:
        AssertionError: naming the first rule that is broken.
    """
    m, p = model.B.shape[1], model.C.shape[0]
    its = controller_traits(controller)
    seen = p * its.samples

    def answers() -> list[Any]:
        rng = np.random.default_rng(3)
        running = asked("start(model)", controller.start, model)
        needs(running, "what start(model) returns", RUNNING)
        chosen = running.selection
        assert chosen in SELECTIONS, f"selection is {chosen!r:.60}, expected one of {', '.join(SELECTIONS)}"
        several, stays = isinstance(running, MultiSampleController), its.row_sojourns
        out = []
        for k in range(60):
            y = tuple(map(float, rng.normal(size=(seen,))))
            if several:
                outputs = model.nodes.outputs
                newest = [Sample(i, k - (k + i) % len(outputs), tuple(y[o] for o in own)) for i, own in enumerate(outputs)]
                known = Known(tuple(s for s in newest if s.slot >= 0), (1.0,) * p)
                rows = asked("rows(k, known)", running.rows, k, known)
            else:
                tau = int(rng.integers(0, model.tau_max + 1))
                rows = asked("rows(k, tau, y, r)", running.rows, k, tau, y, (1.0,) * p)
            expected = row_count(running.selection, model.d_max, stays)
            shape = f"{expected} row{'s' * (expected > 1)} of {m} input{'s' * (m > 1)} in a tuple of tuples"
            what = f"rows() returned {rows!r:.80}, expected {shape}"
            numbers = asked(what, lambda rows=rows: [[float(u) for u in row] for row in rows])
            lists = all(isinstance(each, tuple | list) for each in (rows, *rows))
            assert lists, f"{' '.join(what.split())}; .tolist() makes lists of an array"
            assert len(numbers) == expected, f"{len(numbers)} rows, expected {expected} for {running.selection!r}"
            other = [len(row) for row in numbers if len(row) != m]
            assert not other, f"a row of rows() has {other[0]} numbers, expected {m}, one of each input"
            assert np.isfinite(numbers).all(), "a row is not finite"
            out.append(numbers)
        return out

    assert answers() == answers(), "a fresh start must give the same answers"
