"""Linear models, their discretisation, and the plant that runs one."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plants.errors import PlantError
from plants.parts import DiscreteStateSpace, StateSpace
from plants.parts.flow import Flow
from plants.parts.linear_run import LinearRun

OSCILLATOR = StateSpace(A=[[0.0, 1.0], [-4.0, -0.4]], B=[[0.0, 1.0], [1.0, 0.5]], C=[[1.0, 0.0], [0.5, -1.0]])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"A": [[1.0, 2.0]]}, "A: shape (1, 2), expected a square matrix"),
        ({"B": [[1.0]]}, "B: shape (1, 1), expected (2, m)"),
        ({"C": [[1.0]]}, "C: shape (1, 1), expected (p, 2)"),
        ({"D": [[1.0]]}, "D: shape (1, 1), expected (2, 2)"),
        ({"A": [[0.0, np.nan], [0.0, 0.0]]}, "A[0][1]: nan, expected a finite number"),
    ],
)
def test_a_model_that_does_not_fit_together_is_refused(change, message):
    matrices = {"A": OSCILLATOR.A, "B": OSCILLATOR.B, "C": OSCILLATOR.C, "D": OSCILLATOR.D} | change
    with pytest.raises(ValueError) as fault:
        StateSpace(**matrices)
    assert str(fault.value) == message
    with pytest.raises(ValueError) as fault:
        DiscreteStateSpace(**matrices, period_s=0.1)
    assert str(fault.value) == message


def test_matrices_of_a_model_cannot_be_changed():
    with pytest.raises(ValueError):
        OSCILLATOR.A[0, 0] = 1.0


@pytest.mark.parametrize("period_s", [0.0, -0.1, float("nan"), float("inf")])
def test_a_period_that_is_none_is_refused(period_s):
    with pytest.raises(PlantError, match="period"):
        OSCILLATOR.discretise(period_s)
    with pytest.raises(ValueError, match="period_s"):
        DiscreteStateSpace(A=[[1.0]], B=[[1.0]], C=[[1.0]], period_s=period_s)


def test_python_control_discretises_to_the_same_model():
    control = pytest.importorskip("control")
    theirs = control.c2d(OSCILLATOR.to_control(), 0.1)
    ours = OSCILLATOR.discretise(0.1)
    np.testing.assert_allclose(ours.A, theirs.A, atol=1e-14)
    np.testing.assert_allclose(ours.B, theirs.B, atol=1e-14)
    assert ours.to_control().dt == 0.1


def test_a_running_model_is_its_zero_order_hold():
    discrete = OSCILLATOR.discretise(0.05)
    run = LinearRun(OSCILLATOR, (1.0, -2.0))
    x = np.array([1.0, -2.0])
    rng = np.random.default_rng(1)
    for _ in range(100):
        np.testing.assert_allclose(run.measure(), discrete.C @ x, atol=1e-13)
        u, w = rng.normal(size=2), rng.normal(size=2)
        run.advance(50_000_000, u.tolist(), w.tolist())
        assert run.applied == tuple(u.tolist())
        x = discrete.A @ x + discrete.B @ (u + w)
    np.testing.assert_allclose(run.state, x, atol=1e-13)


times = st.integers(0, 2_000_000_000)


@settings(deadline=None, max_examples=50)
@given(times, times)
def test_two_advances_are_one_of_their_sum(a_ns, b_ns):
    once, twice = LinearRun(OSCILLATOR, (1.0, 0.5)), LinearRun(OSCILLATOR, (1.0, 0.5))
    once.advance(a_ns + b_ns, (0.3, -0.2))
    twice.advance(a_ns, (0.3, -0.2))
    twice.advance(b_ns, (0.3, -0.2))
    assert twice.state == pytest.approx(once.state, rel=1e-13, abs=1e-13)


def test_the_two_ways_of_moving_agree():
    flow = Flow(OSCILLATOR.A.tolist(), OSCILLATOR.B.tolist())
    x, v = [1.0, -1.0], [0.2, 0.1]
    assert flow.drift(x, v, 123_456_789) == pytest.approx(flow.step(x, v, 123_456_789), rel=1e-14)


def test_lengths_that_never_come_again_do_not_fill_the_memory():
    flow = Flow([[-1.0]], [[1.0]])
    for dt_ns in range(1, 300):
        flow.step([1.0], [0.0], dt_ns)
    assert len(flow._steps) <= 64


def test_time_that_runs_backwards_is_refused():
    with pytest.raises(PlantError, match="-1 ns"):
        LinearRun(OSCILLATOR, (0.0, 0.0)).advance(-1, (0.0, 0.0))


def test_a_model_with_feedthrough_cannot_run():
    with pytest.raises(PlantError, match=r"model\.D"):
        LinearRun(StateSpace(A=[[0.0]], B=[[1.0]], C=[[1.0]], D=[[1.0]]), (0.0,))
