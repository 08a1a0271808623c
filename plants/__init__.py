"""What is driven: the plants of a rig, each propagated exactly through time in plain floats.

A plant is a frozen dataclass of parameters. It names its signals (``inputs``, ``outputs``, ``states``), gives the
linear model that a designer sees (``model()``), and starts a running plant (``start(rng)``), which advances by whole
nanoseconds under a held input, and measures.

Importing this package costs nothing: each name brings its module when it is first used, so a run pays for its own plant alone.
"""

from __future__ import annotations

from importlib import import_module
from typing import Final

_NAMES: Final = {
    "plants.dc_motor": "DCMotor LoadTorque",
    "plants.delayed_states": "DelayedStates",
    "plants.errors": "PlantError",
    "plants.fmu": "FMU",
    "plants.fmu_run": "FMURun",
    "plants.omni": "Omni",
    "plants.parts.actuators": "Driver Encoder Friction",
    "plants.parts.check": "check_plant",
    "plants.parts.delayed_run": "DelayedVTOLRun",
    "plants.parts.flow": "JumpProcess",
    "plants.parts.linear": "DiscreteStateSpace Signal StateSpace",
    "plants.parts.linear_run": "LinearRun",
    "plants.parts.motor_run": "DCMotorRun",
    "plants.parts.protocols": "BeyondModel Departure GoesOn HasCost HasDepartures HasOwnInputs HasPassiveElements "
    "HasSensorNoise HasStateDelays HasStateHistory JumpPlant MovesOtherwise PassiveElement Plant PlantRun ReferencesFiles",
    "plants.parts.rubbing_axis": "RubbingAxis",
    "plants.parts.semi_markov": "JumpModel JumpRates TransitionRates",
    "plants.state_space": "LinearPlant TransferFunction from_control to_control",
    "plants.switched_example": "SwitchedExample SwitchedExampleRun",
    "plants.vtol": "VTOL vtol_matrices",
    "plants.vtol_delayed": "DelayedVTOL",
    "plants.vtol_fault": "FaultyVTOL FaultyVTOLRun",
}
"""Module to the public names that it brings; `__init__.pyi` has the same ones for type checkers."""

_HOMES = {name: module for module, names in _NAMES.items() for name in names.split()}

__all__ = sorted(_HOMES)  # noqa: PLE0605


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
