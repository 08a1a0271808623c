"""A plant of a transfer function: it keeps the contract, answers as the theory says, and is refused where it is none."""

from __future__ import annotations

import control
import numpy as np
import pytest

import hil
from plants import DCMotor, Signal, TransferFunction, check_plant

MOTOR = {"num": (170.0,), "den": (1.0, 20.0, 0.0)}


def test_it_keeps_the_contract_of_plants() -> None:
    signals = {"input": Signal("force", "N"), "output": Signal("place", "m")}
    check_plant(TransferFunction(num=(3.0, 1.0), den=(2.0, 1.0, 5.0, 1.0), **signals))


@pytest.mark.parametrize(
    "num, den", [((1.0,), (1.0, 1.0)), ((2.0, 3.0), (4.0, 1.0, 2.0)), ((0.0, 0.0, 5.0), (1.0, 0.2, 3.0, 1.0))]
)
def test_its_frequency_response_is_that_of_the_transfer_function(num: tuple[float, ...], den: tuple[float, ...]) -> None:
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
