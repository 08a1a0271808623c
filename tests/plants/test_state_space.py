"""Plants of matrices: saturated actuators, and noise on states and sensors."""

from __future__ import annotations

import numpy as np
import pytest

import hil
from plants import LinearPlant, check_plant

MATRICES = {"A": ((-1.0,),), "B": ((1.0,),), "C": ((1.0,),)}
NETWORK = {"limits.state": {}, "duration": 3, "controller": -0.2}


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
