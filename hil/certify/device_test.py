"""The test of a device at a wall before a run: it takes the energy that it says, and measures its own position.

A proof of passivity rests on both; what pushes a device from within is the hand's affair.
"""

from __future__ import annotations

import numpy as np

from hil.certify import CertificationProblem, Check
from hil.certify.motion_test import FREE_SIZES, SEED, SHORT, SLOTS, SMALL, drive, random_inputs
from hil.plugins import is_ours
from hil.rig.loop import EQUAL
from plants.parts.protocols import HasOwnInputs

LASTS, MOST_SLOTS = 10.0, 5000
"""Times that damping takes to stop a device, over which its energy is compared; at most so many slots."""


def energy_check(loop: CertificationProblem) -> Check:
    r"""Test, with random forces, that a device dissipates at least what the damping of its model dissipates.

    .. math:: \sum_k u_k d_k - b d_k^2 / T \ge -(m v_0^2 + s x_0^2) / 2, \qquad d_k = x_{k+1} - x_k

    What pushes the device from within gives energy, too: such a device is not compared, and neither is one of ours.
    """
    plant, port, period_s = loop.plant, loop.port, loop.model.period_s
    if port is None or port.output is None or is_ours(plant):
        return None, ()
    if isinstance(plant, HasOwnInputs) and plant.own_inputs():
        return None, (f"the energy that it takes is not compared, for it has {', '.join(plant.own_inputs())}",)
    slots = SLOTS if port.damping <= 0.0 else int(min(max(SLOTS, LASTS * port.mass / (port.damping * period_s)), MOST_SLOTS))
    sizes = FREE_SIZES[:2] if loop.input_limits is None else (SMALL * loop.input_limits[0], loop.input_limits[0])
    for size in sizes:
        track = drive(plant, round(period_s * 1e9), size * random_inputs(slots, 1))
        moved = np.diff(track.outputs[:, port.output])
        x, v = (float(each) for each in track.states[0, :2])
        worked = moved * track.applied[:, 0]
        taken = np.cumsum(worked - port.damping * moved**2 / period_s)
        lacks = -taken - 0.5 * (port.mass * v * v + port.stiffness * x * x) - EQUAL * np.cumsum(np.abs(worked))
        if not lacks.max() <= 0.0:
            return "refused", (
                f"your device does not take energy as it says: under forces up to {size:.3g} {plant.inputs[0].unit} it gives "
                f"{lacks.max():.3g} J more than it had, by slot {int(lacks.argmax())}"
            )
    return None, (f"the device takes what its damping takes: compared over {slots} slots, random forces up to {size:.3g} "
                  f"{plant.inputs[0].unit}",)  # fmt: skip


def measurement_check(loop: CertificationProblem) -> Check:
    """Test, at rest, that a device measures its own position, but for a constant: noise there is no force of a hand."""
    plant, port = loop.plant, loop.port
    if port is None or port.output is None or (isinstance(plant, HasOwnInputs) and len(plant.states) != len(loop.model.A)):
        return None, ()
    rest = np.zeros((SHORT, 1))
    track, other = (drive(plant, round(loop.model.period_s * 1e9), rest, seed) for seed in (SEED, SEED + 7))
    measured = track.outputs[:, port.output]
    own = track.states[:, 0] if len(plant.states) == len(loop.model.A) else other.outputs[:, port.output]
    noise = float(np.ptp(measured - own))
    if noise <= EQUAL * float(np.abs(measured).max()):
        return None, ()
    return "undecided", f"noise of {noise:.3g} {plant.outputs[port.output].unit} is in the measured position, which gives energy"
