"""Linear plants by matrices, by a transfer function and from python-control."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import hil
from plants import DCMotor, LinearPlant, PlantError, Signal, TransferFunction, check_plant, from_control, to_control

MATRICES = {"A": ((-1.0,),), "B": ((1.0,),), "C": ((1.0,),)}
NETWORK = {"limits.state": {}, "duration": 3, "controller": -0.2}


@pytest.fixture(scope="module")
def control() -> Any:
    """python-control: a second of CPU time, which the import of the tests has no need of."""
    import control

    return control


def test_actuators_saturate_and_the_certificate_of_the_model_is_undecided() -> None:
    plant = {"kind": "state-space", **MATRICES, "saturation": [0.25]}
    session = hil.run("dc-motor-hinf", plant=plant, allow_uncertified=True, **NETWORK)
    applied = session.arrays["/actuator/applied"]["u1"]
    assert np.abs(applied).max() > 0.25  # what was commanded
    assert session.arrays["/plant/state"]["x1"].max() < 0.25 + 1e-9  # x' = -x + sat(u)
    assert session.summary["certificate"]["state"] == "undecided"
    assert "saturated actuators" in session.summary["certificate"]["reason"]


def test_noise_has_the_variance_that_is_asked_for_and_keeps_the_contract() -> None:
    plant = LinearPlant(**MATRICES, process_noise=(0.5,), noise_step_s=0.1, measurement_noise=(0.1,))
    said = check_plant(plant)
    assert any("HasSensorNoise" in sentence for sentence in said)
    run = plant.start(np.random.default_rng(0))
    x, y = [], []
    for _ in range(4000):  # slots of two time constants: nearly independent
        run.advance(2_000_000_000, (0.0,))
        x.append(run.state[0])
        y.append(run.measure()[0] - run.state[0])
    # Stationary variance g^2/(2 a) (1 - h^2/12) = 0.125. A sample variance of n deviates by sqrt(2/n) = 2.2 %: five of them.
    assert np.var(x) == pytest.approx(0.125, rel=0.11) and np.var(y) == pytest.approx(0.01, rel=0.11)


def test_noise_comes_from_the_seed_of_the_run_and_leaves_the_loop_certified() -> None:
    plant = {"kind": "state-space", **MATRICES, "process_noise": [0.1], "measurement_noise": [0.01]}
    runs = [hil.run("dc-motor-hinf", plant=plant, seed=seed, **NETWORK) for seed in (1, 1, 2)]
    states = [run.arrays["/plant/state"]["x1"] for run in runs]
    assert (states[0] == states[1]).all() and not (states[0] == states[2]).all()
    certificate = runs[0].summary["certificate"]
    assert certificate["state"] == "certified" and any("process noise" in said for said in certificate["assumptions"])
    swept = hil.sweep("dc-motor-hinf", plant=plant, runs=2, jobs=1, first_seed=1, **NETWORK)
    assert swept.values["sse"].tolist() == [runs[0].metrics["sse"], runs[2].metrics["sse"]]
    quiet = hil.run("dc-motor-hinf", plant=plant | {"process_noise": []}, **NETWORK)
    assert quiet.summary["certificate"]["state"] == "certified"


@pytest.mark.parametrize(
    ("field", "value", "reported"),
    [
        ("saturation", (0.0,), r"saturation\[0\]: 0\.0, expected a finite number > 0"),
        ("saturation", (1.0, 1.0), "saturation: 2 entries, expected 1 or none"),
        ("process_noise", (-1.0,), r"process_noise\[0\]: -1\.0, expected a finite number >= 0"),
        ("measurement_noise", (float("nan"),), r"measurement_noise\[0\]: nan"),
        ("noise_step_s", 1e-7, "noise_step_s: 1e-07 s, expected at least 1e-05 s"),
    ],
)
def test_a_faulty_parameter_is_named(field: str, value: object, reported: str) -> None:
    with pytest.raises(ValueError, match=reported):
        LinearPlant(**MATRICES, **{field: value})


MOTOR = {"num": (170.0,), "den": (1.0, 20.0, 0.0)}


def test_it_keeps_the_contract_of_plants() -> None:
    signals = {"input": Signal("force", "N"), "output": Signal("place", "m")}
    check_plant(TransferFunction(num=(3.0, 1.0), den=(2.0, 1.0, 5.0, 1.0), **signals))


@pytest.mark.parametrize(
    "num, den", [((1.0,), (1.0, 1.0)), ((2.0, 3.0), (4.0, 1.0, 2.0)), ((0.0, 0.0, 5.0), (1.0, 0.2, 3.0, 1.0))]
)
def test_its_frequency_response_is_that_of_the_transfer_function(
    num: tuple[float, ...], den: tuple[float, ...], control: Any
) -> None:
    model = TransferFunction(num=num, den=den).model().to_control()
    w = 1j * np.logspace(-2, 2, 9)
    assert np.allclose(model(w), control.tf(num, den)(w), rtol=1e-12)


def test_it_steps_as_the_motor_of_the_same_transfer_function() -> None:
    rng = np.random.default_rng(0)
    one, other = TransferFunction(**MOTOR).start(rng), DCMotor(gain=170.0, pole=20.0).start(rng)
    for _ in range(40):
        one.advance(50_000_000, (0.3,))
        other.advance(50_000_000, (0.3,))
        assert one.measure() == pytest.approx(other.measure(), rel=1e-9)


@pytest.mark.parametrize(
    "table, says",
    [
        ({"num": (), "den": (1.0, 1.0)}, "num"),
        ({"num": (1.0,), "den": (0.0, 1.0)}, "den: begins with 0"),
        ({"num": (0.0,), "den": (1.0, 1.0)}, "num: is 0"),
        ({"num": (1.0, 0.0), "den": (1.0, 1.0)}, "num: is not of a lower degree"),
        ({"num": (1.0,), "den": (1.0, float("inf"))}, "den"),
        ({"num": (1.0,), "den": (1.0, 1.0), "input": Signal("F orce", "N")}, "no name"),
    ],
)
def test_what_is_no_strictly_proper_plant_is_refused(table: dict[str, tuple[float, ...]], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        TransferFunction(**table)  # type: ignore[arg-type]


def test_an_experiment_names_it_and_runs_as_with_the_motor() -> None:
    table = {"kind": "transfer-function", "num": [170.0], "den": [1.0, 20.0, 0.0]}
    signals = {"output": ["angle", "rad"], "input": ["voltage", "V"]}
    changes = {"plant": table | signals, "limits.state": {}, "duration": 5}
    session = hil.run("dc-motor-hinf", seed=2, **changes)
    plain = hil.run("dc-motor-hinf", seed=2, duration=5, **{"plant.gain": 170.0, "plant.pole": 20.0})
    assert session.run.resolved["plant"]["kind"] == "transfer-function"
    assert session.metrics["sse"] == pytest.approx(plain.metrics["sse"], rel=1e-5)
    assert session.summary["units"]["sse"] == "rad² s"


def test_a_transfer_function_becomes_a_plant_that_moves_as_it_says(control: Any) -> None:
    oscillator = control.tf([2.0], [1.0, 0.4, 4.0])
    plant = from_control(oscillator, inputs=[Signal("force", "N")], outputs=[Signal("position", "m")])
    check_plant(plant)
    run = plant.start(np.random.default_rng(0))
    ours = []
    for _ in range(40):
        run.advance(50_000_000, (1.0,))
        ours.append(run.measure()[0])
    theirs = control.step_response(oscillator, T=0.05 * np.arange(41)).outputs[1:]
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
    ("form", "given", "fault"),
    [
        ("ss", ([[0.5]], [[1]], [[1]], [[0]], 0.1), "period"),
        ("tf", ([1, 0], [1, 1]), "D is not zero"),
        ("ss", ([], [], [], [[2.0]]), "D is not zero"),
    ],
)
def test_what_a_rig_cannot_move_is_refused(form: str, given: tuple[Any, ...], fault: str, control: Any) -> None:
    with pytest.raises(PlantError, match=fault):
        from_control(getattr(control, form)(*given))


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        ({"A": ((1.0, 2.0), (3.0,))}, "A: expected rows"),
        ({"B": ((1.0,),)}, "B: shape"),
        ({"C": ((float("nan"), 0.0),)}, r"C\[0\]\[0\]"),
        ({"inputs": (Signal("Force", "N"),)}, "inputs: 'Force' is no name; expected a letter, then"),
        ({"states": (Signal("x", "1"), Signal("x", "1"))}, "taken twice"),
        ({"outputs": (Signal("a", "1"), Signal("b", "1"))}, "outputs: 2 signals"),
        ({"initial_state": (0.0,)}, "initial_state"),
    ],
)
def test_matrices_and_names_are_checked(change: dict[str, object], fault: str) -> None:
    good = {"A": ((0.0, 1.0), (-1.0, -1.0)), "B": ((0.0,), (1.0,)), "C": ((1.0, 0.0),)}
    with pytest.raises(ValueError, match=fault):
        LinearPlant(**(good | change))  # type: ignore[arg-type]


def test_an_experiment_runs_a_model_and_a_fixed_gain_of_python_control_and_its_log_names_them(control: Any) -> None:
    slow = control.tf([1.0], [1.0, 1.0])
    session = hil.run("dc-motor-hinf", duration=2, plant=slow, controller=control.tf([-0.3], [1]), **{"limits.state": {}})
    assert session.run.resolved["plant"]["kind"] == "state-space"
    assert session.run.resolved["controller"] == {"kind": "local", "gain": [[-0.3]]}
    assert session.summary["certificate"] is not None
    with pytest.raises(hil.HilError, match="no fixed gain"):
        hil.run("dc-motor-hinf", controller=slow)


def test_a_controller_with_states_of_python_control_runs_and_is_judged_over_the_network(control: Any) -> None:
    lag = control.ss([[0.5]], [[1.0]], [[-0.01]], [[-0.01]], 0.05)
    session = hil.run("dc-motor-hinf", duration=2, controller=lag)
    matrices = {"A": [[0.5]], "B": [[1.0]], "C": [[-0.01]], "D": [[-0.01]]}
    assert session.run.resolved["controller"] == {"kind": "output-feedback", **matrices}
    assert session.summary["certificate"]["state"] == "certified"
    assert session.summary["certificate"]["method"] == "second moments of the jump-linear loop (Theorem 7.1)"
