import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plants.dc_motor import DCMotor
from tests.hil.measure.whole_arrays import tracking_of_arrays

T = 0.05


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
