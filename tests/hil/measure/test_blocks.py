"""What is read in blocks gives the numbers of whole arrays, bit for bit."""

import tracemalloc

import numpy as np
import pytest

from hil.log.append_column import ROWS
from hil.log.read.run import Run
from hil.log.records import Field, Schema
from hil.log.topics import STATE
from hil.measure import signals
from hil.measure.cost import Cost
from hil.measure.signals import target_of
from hil.measure.view import APPLIED, DISTURBANCE, MEASUREMENT, REFERENCE, REFERENCE_STEP, view_of
from tests.hil.measure.whole_arrays import tracking_of_arrays

TOPICS = (MEASUREMENT, REFERENCE, APPLIED)

BLOCK = 256  # the smallest that keeps numpy's halving: it adds up to 128 entries in eight lanes


@pytest.fixture(autouse=True)
def short_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(signals, "LEAF", BLOCK)


def test_a_sum_by_halves_is_numpys_sum() -> None:
    rng = np.random.default_rng(0)
    for n in [1, 128, 255, 256, 257, 263, 264, 265, 512, 1000, 4096, 5001, *rng.integers(1, 20_000, 40).tolist()]:
        column = rng.standard_normal(n) * 10.0 ** rng.integers(-8, 8, n)
        assert signals.pairwise_sum(lambda i, j, c=column: c[i:j], n) == np.sum(column)


@pytest.mark.parametrize("outputs", [1, 2, 9])
@pytest.mark.parametrize("change", [None, 1, 255, 256, 1500])
def test_errors_in_blocks_are_those_of_whole_arrays(outputs: int, change: int | None) -> None:
    rng, n, period_s = np.random.default_rng(outputs), 3001, 0.01
    t, r = np.arange(n) * period_s, np.zeros((n, outputs))
    if change is not None:
        r[change:] += 3.0
    y = r * (1.0 - np.exp(-(t - t[change or 0]).clip(0.0) / 2.0))[:, None] + 1e-3 * rng.standard_normal((n, outputs))
    u = rng.standard_normal((n - 1, 1))
    found = tracking_of_arrays(t, y, r, u, period_s)
    error = y - target_of(r)
    squared = np.sum(error**2, axis=1)
    assert found["sse"] == period_s * float(np.sum(squared))
    assert found["sse_after_5s"] == period_s * float(np.sum(squared[t >= 5.0 - 1e-9]))
    assert found["steady_state_error"] == max((float(np.mean(c)) for c in error[-300:].T), key=abs)
    assert found["max_abs_u"] == float(np.max(np.abs(u)))
    if change is not None:
        outside = np.flatnonzero(~np.all(np.abs(error[change:]) <= 0.02 * 3.0, axis=1))
        assert found["settling_time_s"] == t[change:][outside[-1] + 1] - t[change]
        assert found["overshoot"] == 100.0 * max(float(np.max(error[change:] / 3.0)), 0.0)


def test_steps_and_disturbances_are_marked_once_wherever_a_piece_ends() -> None:
    n = 2 * ROWS + 5
    slots, changes, pulse = np.arange(n), [1, ROWS, 2 * ROWS + 1], range(ROWS - 2, ROWS + 3)
    reference = np.zeros(n, [("t_ns", "<i8"), ("angle", "<f8"), ("slot", "<i8")])
    reference["t_ns"], reference["slot"] = slots * 10**6, slots
    for at in changes:
        reference["angle"][at:] += 1.0
    applied = np.zeros(n, [("t_ns", "<i8"), ("volt", "<f8"), ("w_volt", "<f8"), ("slot", "<i8")])
    applied["t_ns"], applied["slot"] = slots * 10**6, slots
    applied["w_volt"][list(pulse)] = 0.5
    view = view_of(Run(
        arrays={MEASUREMENT: reference, REFERENCE: reference, APPLIED: applied},
        schemas={topic: Schema(name="hil/msg/Any", fields=(Field(type="float64", name="angle"),)) for topic in TOPICS},
        resolved={"period": 1e-3},
    ))  # fmt: skip
    found = [(mark.label, round(mark.t_s * 1e3)) for mark in view.marks]
    assert found == [*((REFERENCE_STEP, at) for at in changes), (DISTURBANCE, pulse[0])]
    assert view.followed().changes(9) == changes


@pytest.mark.parametrize(("slots", "period_s"), [((), 1.0), ((3,), 1.0), ((3, 4), 0.02), ((3, 4, 5, 9), 0.02)])
def test_without_a_stated_period_it_is_that_of_the_records(slots: tuple[int, ...], period_s: float) -> None:
    measured = np.zeros(len(slots), [("t_ns", "<i8"), ("angle", "<f8"), ("slot", "<i8")])
    measured["t_ns"] = np.array(slots, dtype=np.int64) * 20 * 10**6
    schema = Schema(name="hil/msg/Any", fields=(Field(type="float64", name="angle"),))
    assert view_of(Run(arrays={MEASUREMENT: measured}, schemas={MEASUREMENT: schema})).period_s == period_s


def test_a_cost_in_pieces_is_that_of_whole_arrays_and_never_holds_them() -> None:
    n, rng = 4 * ROWS + 5, np.random.default_rng(3)
    states = np.zeros(n, [("t_ns", "<i8"), ("x1", "<f8"), ("x2", "<f8"), ("slot", "<i8")])
    states["x1"], states["x2"], states["slot"] = *rng.standard_normal((2, n)), np.arange(n)
    applied = np.zeros(n, [("t_ns", "<i8"), ("volt", "<f8"), ("slot", "<i8")])
    applied["volt"], applied["slot"] = rng.standard_normal(n), np.arange(n)
    schema = Schema(name="hil/msg/Any", fields=(Field(type="float64", name="volt"),))
    arrays = {STATE.name: states, MEASUREMENT: applied, REFERENCE: applied, APPLIED: applied}
    view = view_of(Run(arrays=arrays, schemas=dict.fromkeys(arrays, schema), resolved={"period": 1e-3}))
    tracemalloc.start()
    found = Cost().of(view)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert found["cost"] == pytest.approx(float(states["x1"] @ states["x1"] + states["x2"] @ states["x2"]), rel=1e-12)
    assert found["peak_input"] == float(np.abs(applied["volt"]).max())
    assert peak < n * 16  # the states alone as one matrix
