"""How well the outputs followed the reference; what is read in blocks gives the numbers of whole arrays, bit for bit."""

import math
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.log.append_column import ROWS
from hil.log.read import Run
from hil.log.records import Field, Schema
from hil.log.topics import STATE
from hil.measure import signals
from hil.measure.cost import Cost
from hil.measure.signals import Followed, target_of
from hil.measure.tracking import tracking_metrics
from hil.measure.view import APPLIED, DISTURBANCE, MEASUREMENT, REFERENCE, REFERENCE_STEP, matrix, view_of
from plants.dc_motor import DCMotor

T = 0.05


def tracking_of_arrays(
    t: np.ndarray, y: np.ndarray, r: np.ndarray, u: np.ndarray, period_s: float, *, disturbed_at_s: float | None = None
) -> dict[str, float | None]:
    """`tracking_metrics` of a run in arrays: times (n,), outputs and reference (n,) or (n, p) each; u: (n,) or (n, m)."""
    y, r = (each[:, None] if each.ndim == 1 else each for each in (y, r))
    blocks = Followed(slots=len(t), of=lambda i, j: (t[i:j], y[i:j], r[i:j]))
    return tracking_metrics(blocks, [u], period_s, disturbed_at_s=disturbed_at_s)


def motor_step(gain: float = -0.1, duration_s: float = 50.0, step_s: float = 1.0) -> tuple[np.ndarray, ...]:
    """A real closed loop: the motor under u = gain * (y - r), held over T."""
    n = round(duration_s / T)
    plant = DCMotor().start(np.random.default_rng(0))
    t = np.arange(n) * T
    r = np.where(t >= step_s - 1e-9, 3.0, 0.0)
    y, u = np.zeros(n), np.zeros(n)
    for k in range(n):
        y[k] = plant.measure()[0]
        u[k] = gain * (y[k] - r[k])
        plant.advance(round(T * 1e9), (float(u[k]),))
    return t, y, r, u


def test_error_counts_against_the_final_reference_before_the_step_too() -> None:
    t, y, r, u = motor_step()
    found = tracking_of_arrays(t, y, r, u, T)
    assert found["sse"] == pytest.approx(T * np.sum((y - 3.0) ** 2), rel=1e-12)
    before = T * np.sum((y[t < 1.0 - 1e-9] - 3.0) ** 2)
    assert before == pytest.approx(9.0), "9 of the 11.29 of Table 7.2 is the second before the step"
    assert found["sse_after_5s"] == pytest.approx(T * np.sum((y[100:] - 3.0) ** 2), rel=1e-12)
    assert found["max_abs_u"] == pytest.approx(0.3)


def test_step_response_marks_are_those_of_the_curve() -> None:
    t, y, r, u = motor_step(gain=-0.1)
    found = tracking_of_arrays(t, y, r, u, T)
    assert found["overshoot"] == pytest.approx(100.0 * (y.max() / 3.0 - 1.0))
    settled = found["settling_time_s"]
    assert settled is not None
    k = round((1.0 + settled) / T)
    assert np.all(np.abs(y[k:] - 3.0) <= 0.06) and abs(y[k - 1] - 3.0) > 0.06
    assert found["steady_state_error"] == pytest.approx(0.0, abs=1e-6)


def test_settling_is_judged_before_the_disturbance() -> None:
    t, y, r, u = motor_step()
    y[600:640] += 0.5
    whole = tracking_of_arrays(t, y, r, u, T)["settling_time_s"]
    window = tracking_of_arrays(t, y, r, u, T, disturbed_at_s=30.0)
    assert whole is not None and whole > 29.0
    assert window["settling_time_s"] == tracking_of_arrays(*motor_step(), T)["settling_time_s"]
    assert window["overshoot"] == tracking_of_arrays(*motor_step(), T)["overshoot"]


def test_downward_step_overshoots_downward() -> None:
    t, y, r, u = motor_step()
    down = tracking_of_arrays(t, -y, -r, -u, T)
    assert down == pytest.approx(tracking_of_arrays(t, y, r, u, T) | {"steady_state_error": down["steady_state_error"]})


def test_several_outputs_add_their_errors_and_show_their_worst() -> None:
    t, y, r, u = motor_step()
    slow = 3.0 * (1.0 - np.exp(-np.maximum(t - 1.0, 0.0) / 4.0))
    both = tracking_of_arrays(t, np.column_stack((y, slow)), np.column_stack((r, r)), u, T)
    one, two = tracking_of_arrays(t, y, r, u, T), tracking_of_arrays(t, slow, r, u, T)
    assert both["sse"] == pytest.approx(one["sse"] + two["sse"])  # type: ignore[operator]
    assert both["settling_time_s"] == two["settling_time_s"]
    assert both["overshoot"] == one["overshoot"]


def test_later_steps_count_against_their_own_value() -> None:
    t = np.arange(0.0, 4.0, 0.5)
    r = np.array([0, 0, 1, 1, 2, 2, 2, 2], dtype=float)
    found = tracking_of_arrays(t, r, r, np.zeros(8), 0.5)
    assert found["sse"] == pytest.approx(1.0), "only the second before the first step"


@pytest.mark.parametrize("n", [0, 1])
def test_too_few_samples_leave_marks_undefined(n: int) -> None:
    found = tracking_of_arrays(np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n), T)
    assert found["overshoot"] is None and found["settling_time_s"] is None
    assert found["sse"] == (0.0 if n else None) and found["sse_after_5s"] is None


def test_run_that_never_settles_says_so() -> None:
    t = np.arange(0.0, 20.0, T)
    r = np.where(t >= 1.0, 3.0, 0.0)
    assert tracking_of_arrays(t, np.sin(t), r, t, T)["settling_time_s"] is None


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(0, 60))
def test_metrics_are_finite_or_undefined_for_any_values(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    pool = np.array([0.0, 1.0, -1.0, np.nan, np.inf, -np.inf, 1e308, -1e308, 5e-324])
    y, u = rng.choice(pool, (n, 2)), rng.choice(pool, n)
    r = rng.choice(np.array([0.0, 3.0]), (n, 2))
    for value in tracking_of_arrays(np.arange(n) * T, y, r, u, T, disturbed_at_s=1.0).values():
        assert value is None or math.isfinite(value)


def test_the_steady_state_error_is_that_of_the_last_tenth() -> None:
    t = np.arange(100) * 0.1
    y, r = np.where(t >= 9.0 - 1e-9, 1.5, 1.0), np.ones(100)
    y[80:90] = 3.0  # in the last fifth, and not in the last tenth
    assert tracking_of_arrays(t, y, r, np.zeros(100), 0.1)["steady_state_error"] == pytest.approx(0.5)


def test_a_run_that_only_crosses_the_band_at_its_end_has_not_settled() -> None:
    t = np.arange(0.0, 10.0, T)
    r, y = np.where(t >= 1.0, 3.0, 0.0), 3.0 * (t - 1.0) / 9.0  # a ramp that reaches the band 0.18 s before the end
    assert abs(y[-1] - 3.0) < 0.06
    assert tracking_of_arrays(t, y, r, y, T)["settling_time_s"] is None


@pytest.mark.parametrize("inside, settled", [(9, False), (10, True)])
def test_the_last_tenth_of_the_window_must_lie_in_the_band(inside: int, settled: bool) -> None:
    t = np.arange(101) * 1.0
    r = np.where(t >= 1.0, 1.0, 0.0)
    y = np.where(np.arange(101) > 100 - inside, 1.0, 0.5)
    found = tracking_of_arrays(t, y, r, np.zeros(101), 1.0)["settling_time_s"]
    assert found == (100.0 - inside if settled else None)


def test_outputs_of_several_units_are_never_added() -> None:
    import hil
    from hil.measure.tracking import Tracking
    from hil.measure.view import view_of

    rows = {
        "plant": {
            "kind": "state-space", "A": [[-1.0, 0.0], [0.0, -2.0]], "B": [[1.0], [1.0]], "C": [[1.0, 0.0], [0.0, 1.0]],
            "inputs": [["f", "N"]], "outputs": [["a", "rad"], ["s", "m"]],
        },
        "controller": {"kind": "constant", "value": [1.0]},
    }  # fmt: skip
    changes = {"limits.input": [9.0], "limits.state": {}, "disturbance": [], "reference": [{"at": "1 s", "value": [1.0, 1.0]}]}
    session = hil.run("dc-motor-hinf", duration=3, **(rows | changes), allow_uncertified=True)
    assert session.metrics["sse"] is None and session.metrics["steady_state_error"] is None
    assert session.metrics["max_abs_u"] == 1.0
    view = view_of(session.run)
    for name in ("a", "s"):
        assert session.metrics["outputs"][name]["sse"] == Tracking().of(view.only(name))["sse"] > 0.0  # type: ignore[operator]


def test_runs_of_a_sweep_settle_as_one_run_does() -> None:
    import hil

    for duration in (3, 12):  # some only cross the band; all have settled
        many = hil.sweep("dc-motor-hinf", runs=4, jobs=1, duration=duration).values["settling_time_s"]
        alone = [hil.run("dc-motor-hinf", seed=seed, duration=duration).metrics["settling_time_s"] for seed in range(4)]
        assert many.tolist() == pytest.approx([np.nan if value is None else value for value in alone], nan_ok=True)


TOPICS = (MEASUREMENT, REFERENCE, APPLIED)

BLOCK = 256  # the smallest that keeps numpy's halving: it adds up to 128 entries in eight lanes


@pytest.fixture
def short_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(signals, "LEAF", BLOCK)


@pytest.mark.usefixtures("short_blocks")
def test_a_sum_by_halves_is_numpys_sum() -> None:
    rng = np.random.default_rng(0)
    for n in [1, 128, 255, 256, 257, 263, 264, 265, 512, 1000, 4096, 5001, *rng.integers(1, 20_000, 40).tolist()]:
        column = rng.standard_normal(n) * 10.0 ** rng.integers(-8, 8, n)
        assert signals.pairwise_sum(lambda i, j, c=column: c[i:j], n) == np.sum(column)


@pytest.mark.usefixtures("short_blocks")
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


@pytest.mark.usefixtures("short_blocks")
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


def test_what_belongs_together_has_one_slot_and_a_long_matrix_is_that_of_its_columns() -> None:
    y, r = (np.zeros(len(slots), [("t_ns", "<i8"), ("angle", "<f8"), ("slot", "<i8")]) for slots in ([0, 1, 2, 4], [0, 1, 3, 4]))
    y["slot"], r["slot"] = [0, 1, 2, 4], [0, 1, 3, 4]
    for each, scale in ((y, 1.0), (r, 10.0)):
        each["t_ns"], each["angle"] = each["slot"] * 10**9, scale * each["slot"]
    schema = Schema(name="hil/msg/Any", fields=(Field(type="float64", name="angle"),))
    view = view_of(Run(arrays={MEASUREMENT: y, REFERENCE: r}, schemas=dict.fromkeys((MEASUREMENT, REFERENCE), schema)))
    times, outputs, reference = view.tracking()
    assert times.tolist() == [0.0, 1.0, 4.0] and outputs.tolist() == [[0.0], [1.0], [4.0]]
    assert reference.tolist() == [[0.0], [10.0], [40.0]] and view.period_s == 1.0
    long = np.zeros(2 * ROWS + 5, y.dtype)
    long["angle"], long["slot"] = np.arange(len(long)) / 7.0, np.arange(len(long))
    assert np.array_equal(matrix(long, ["slot", "angle"]), np.column_stack((long["slot"], long["angle"])))
    assert matrix(long, []).shape == (len(long), 0)


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
