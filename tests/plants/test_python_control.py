"""Plants from and to python-control."""

from __future__ import annotations

import control
import numpy as np
import pytest

import hil
from plants import DCMotor, LinearPlant, PlantError, Signal, check_plant, from_control, to_control

OSCILLATOR = control.tf([2.0], [1.0, 0.4, 4.0])


def test_a_transfer_function_becomes_a_plant_that_moves_as_it_says() -> None:
    plant = from_control(OSCILLATOR, inputs=[Signal("force", "N")], outputs=[Signal("position", "m")])
    check_plant(plant)
    run = plant.start(np.random.default_rng(0))
    ours = []
    for _ in range(40):
        run.advance(50_000_000, (1.0,))
        ours.append(run.measure()[0])
    theirs = control.step_response(OSCILLATOR, T=0.05 * np.arange(41)).outputs[1:]
    np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-12)


def test_there_and_back_is_the_same_model() -> None:
    plant = DCMotor()
    back = from_control(to_control(plant), inputs=plant.inputs, outputs=plant.outputs, states=plant.states)
    for name in "ABC":
        np.testing.assert_array_equal(getattr(back.model(), name), getattr(plant.model(), name))
    assert to_control(plant).input_labels == [s.name for s in plant.inputs]
    assert to_control(plant).output_labels == [s.name for s in plant.outputs]
    assert to_control(plant).state_labels == [s.name for s in plant.states]
    assert to_control(plant.model().discretise(0.1)).dt == 0.1


@pytest.mark.parametrize(
    ("system", "fault"),
    [
        (control.ss([[0.5]], [[1]], [[1]], [[0]], 0.1), "period"),
        (control.tf([1, 0], [1, 1]), "D is not zero"),
        (control.ss([], [], [], [[2.0]]), "D is not zero"),
    ],
)
def test_what_a_rig_cannot_move_is_refused(system: control.StateSpace, fault: str) -> None:
    with pytest.raises(PlantError, match=fault):
        from_control(system)


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        ({"A": ((1.0, 2.0), (3.0,))}, "A: expected rows"),
        ({"B": ((1.0,),)}, "B: shape"),
        ({"C": ((float("nan"), 0.0),)}, r"C\[0\]\[0\]"),
        ({"inputs": (Signal("Force", "N"),)}, "inputs: 'Force' is no name"),
        ({"states": (Signal("x", "1"), Signal("x", "1"))}, "taken twice"),
        ({"outputs": (Signal("a", "1"), Signal("b", "1"))}, "outputs: 2 signals"),
        ({"initial_state": (0.0,)}, "initial_state"),
    ],
)
def test_matrices_and_names_are_checked(change: dict[str, object], fault: str) -> None:
    good = {"A": ((0.0, 1.0), (-1.0, -1.0)), "B": ((0.0,), (1.0,)), "C": ((1.0, 0.0),)}
    with pytest.raises(ValueError, match=fault):
        LinearPlant(**(good | change))  # type: ignore[arg-type]


def test_an_experiment_runs_a_model_and_a_fixed_gain_of_python_control_and_its_log_names_them() -> None:
    slow = control.tf([1.0], [1.0, 1.0])
    session = hil.run("dc-motor-hinf", duration=2, plant=slow, controller=control.tf([-0.3], [1]), **{"limits.state": {}})
    assert session.run.resolved["plant"]["kind"] == "state-space"
    assert session.run.resolved["controller"] == {"kind": "local", "gain": [[-0.3]]}
    assert session.summary["certificate"] is not None
    with pytest.raises(hil.HilError, match="no fixed gain"):
        hil.run("dc-motor-hinf", controller=slow)


def test_a_controller_with_states_of_python_control_runs_and_is_judged_over_the_network() -> None:
    lag = control.ss([[0.5]], [[1.0]], [[-0.01]], [[-0.01]], 0.05)
    session = hil.run("dc-motor-hinf", duration=2, controller=lag)
    matrices = {"A": [[0.5]], "B": [[1.0]], "C": [[-0.01]], "D": [[-0.01]]}
    assert session.run.resolved["controller"] == {"kind": "output-feedback", **matrices}
    assert session.summary["certificate"]["state"] == "certified"
    assert session.summary["certificate"]["method"] == "second moments of the jump-linear loop (Theorem 7.1)"
