"""Many runs of a plant at once have bit for bit what each has alone, whatever is held and for however long."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from plants.dc_motor import DCMotor, LoadTorque
from plants.delayed_states import DelayedStates
from plants.parts.actuators import Driver, Encoder, Friction
from plants.state_space import LinearPlant, TransferFunction
from plants.vtol import VTOL

DRIVER = Driver(saturation_v=0.05, pwm_step_v=0.0005, dead_zone_v=0.003)
DRY = Friction(coulomb_v=0.002, static_v=0.004, stribeck_speed_rad_s=0.3, viscous_v_s_per_rad=0.001)
LOAD = LoadTorque(torque_v=0.006, start_s=0.05, stop_s=0.11)
"""Both instants are ends of a slot of 10 ms."""
PLANTS: dict[str, Any] = {
    "motor": DCMotor(initial_angle_rad=0.3, load=LOAD, tachometer=True),
    "viscous motor": DCMotor(friction=Friction(viscous_v_s_per_rad=0.01), encoder=Encoder(step_rad=0.0038)),
    "rubbing motor": DCMotor(initial_speed_rad_s=2.0, friction=DRY, driver=DRIVER, load=LOAD, encoder=Encoder(step_rad=0.001)),
    "disturbed driver": DCMotor(friction=DRY, driver=DRIVER, disturbance_through_driver=True),
    "helicopter": VTOL(initial_state=(1.0, -0.5, 0.2, 0.1)),
    "matrices": LinearPlant(
        A=((-1.0, 0.3), (0.0, 0.2)), B=((1.0, 0.0), (-0.4, 2.0)), C=((1.0, -2.0), (0.0, 0.7)), initial_state=(0.1, -0.2)
    ),
    "transfer function": TransferFunction(num=(1.0, 2.0), den=(1.0, 0.4, 3.0)),
    "delayed states": DelayedStates(
        A=((0.9, 0.1), (-0.2, 0.8)), delayed=(((0.02, 0.0), (0.01, -0.03)), ((0.0, 0.04), (0.0, 0.0))), B=((0.1,), (1.0,)),
        period_s=0.01, weight=((1.0, 0.0), (0.0, 1.0)), initial_state=(0.1, -0.2), initial_history=((1.0, -1.0), (0.5, 0.25)),
    ),
}  # fmt: skip
SPANS_NS = [10_000_000] * 12 + [3_000_001, 7_000_000, 0, 25_000_000, 9_999_999] * 3


@pytest.mark.parametrize("name", PLANTS)
def test_runs_at_once_are_the_same_as_alone(name: str) -> None:
    plant, rng = PLANTS[name], np.random.default_rng(5)
    alone = [plant.start(np.random.default_rng(0)) for _ in range(4)]
    many = plant.start_batch(4)
    inputs = len(plant.inputs)
    for dt_ns in SPANS_NS:
        u, w = rng.normal(scale=0.04, size=(inputs, 4)), rng.normal(scale=0.004, size=inputs).tolist()
        for run, held in zip(alone, u.T.tolist()):
            run.advance(dt_ns, held, w)
        many.advance(dt_ns, u, w)
        assert many.state.T.tolist() == [list(run.state) for run in alone]
        assert many.measure().T.tolist() == [list(run.measure()) for run in alone]
