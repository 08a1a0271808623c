"""What is driven: the plants of a rig, each propagated exactly through time in plain floats.

A plant is a frozen dataclass of parameters. It names its signals (``inputs``, ``outputs``, ``states``), gives the
linear model that a designer sees (``model()``), and starts a running plant (``start(rng)``), which advances by whole
nanoseconds under a held input, and measures.

Importing this package costs nothing: each name brings its module when it is first used, so a run pays for its own plant alone.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from plants.dc_motor import DCMotor, DCMotorRun, LoadTorque
    from plants.delayed_states import DelayedStates
    from plants.errors import PlantError
    from plants.fmu import FMU
    from plants.fmu_run import FMURun
    from plants.omni import Omni
    from plants.parts.actuators import Driver
    from plants.parts.check import check_plant
    from plants.parts.friction import Friction, RubbingAxis
    from plants.parts.jump import JumpModel, JumpRates
    from plants.parts.linear import DiscreteStateSpace, LinearRun, Signal, StateSpace
    from plants.parts.protocols import (
        BeyondModel,
        HasCost,
        HasOwnInputs,
        HasSensorNoise,
        HasStateDelays,
        HasStateHistory,
        JumpPlant,
        MovesOtherwise,
        Plant,
        PlantRun,
        ReferencesFiles,
    )
    from plants.parts.semi_markov import JumpProcess, TransitionRates
    from plants.parts.sensors import Encoder
    from plants.python_control import from_control, to_control
    from plants.state_space import LinearPlant
    from plants.switched_example import SwitchedExample, SwitchedExampleRun
    from plants.transfer_function import TransferFunction
    from plants.vtol import VTOL, vtol_matrices
    from plants.vtol_delayed import DelayedVTOL, DelayedVTOLRun
    from plants.vtol_fault import FaultyVTOL, FaultyVTOLRun

_HOMES: Final = {
    "BeyondModel": "plants.parts.protocols",
    "DCMotor": "plants.dc_motor",
    "DCMotorRun": "plants.dc_motor",
    "DelayedStates": "plants.delayed_states",
    "DelayedVTOL": "plants.vtol_delayed",
    "DelayedVTOLRun": "plants.vtol_delayed",
    "DiscreteStateSpace": "plants.parts.linear",
    "Driver": "plants.parts.actuators",
    "Encoder": "plants.parts.sensors",
    "FMU": "plants.fmu",
    "FMURun": "plants.fmu_run",
    "FaultyVTOL": "plants.vtol_fault",
    "FaultyVTOLRun": "plants.vtol_fault",
    "Friction": "plants.parts.friction",
    "HasCost": "plants.parts.protocols",
    "HasOwnInputs": "plants.parts.protocols",
    "HasSensorNoise": "plants.parts.protocols",
    "HasStateDelays": "plants.parts.protocols",
    "HasStateHistory": "plants.parts.protocols",
    "JumpModel": "plants.parts.jump",
    "JumpPlant": "plants.parts.protocols",
    "MovesOtherwise": "plants.parts.protocols",
    "JumpProcess": "plants.parts.semi_markov",
    "JumpRates": "plants.parts.jump",
    "LinearPlant": "plants.state_space",
    "LinearRun": "plants.parts.linear",
    "LoadTorque": "plants.dc_motor",
    "ReferencesFiles": "plants.parts.protocols",
    "Omni": "plants.omni",
    "Plant": "plants.parts.protocols",
    "PlantError": "plants.errors",
    "PlantRun": "plants.parts.protocols",
    "RubbingAxis": "plants.parts.friction",
    "Signal": "plants.parts.linear",
    "StateSpace": "plants.parts.linear",
    "SwitchedExample": "plants.switched_example",
    "SwitchedExampleRun": "plants.switched_example",
    "TransferFunction": "plants.transfer_function",
    "TransitionRates": "plants.parts.semi_markov",
    "VTOL": "plants.vtol",
    "check_plant": "plants.parts.check",
    "from_control": "plants.python_control",
    "to_control": "plants.python_control",
    "vtol_matrices": "plants.vtol",
}

__all__ = [
    "FMU",
    "VTOL",
    "BeyondModel",
    "DCMotor",
    "DCMotorRun",
    "DelayedStates",
    "DelayedVTOL",
    "DelayedVTOLRun",
    "DiscreteStateSpace",
    "Driver",
    "Encoder",
    "FMURun",
    "FaultyVTOL",
    "FaultyVTOLRun",
    "Friction",
    "HasCost",
    "HasOwnInputs",
    "HasSensorNoise",
    "HasStateDelays",
    "HasStateHistory",
    "JumpModel",
    "JumpPlant",
    "JumpProcess",
    "JumpRates",
    "LinearPlant",
    "LinearRun",
    "LoadTorque",
    "MovesOtherwise",
    "Omni",
    "Plant",
    "PlantError",
    "PlantRun",
    "ReferencesFiles",
    "RubbingAxis",
    "Signal",
    "StateSpace",
    "SwitchedExample",
    "SwitchedExampleRun",
    "TransferFunction",
    "TransitionRates",
    "check_plant",
    "from_control",
    "to_control",
    "vtol_matrices",
]


if not TYPE_CHECKING:  # a type checker shall tell a name that is not there

    def __getattr__(name: str) -> object:
        if name not in _HOMES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
