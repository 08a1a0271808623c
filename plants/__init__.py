"""What is driven: the plants of a rig, each propagated exactly through time in plain floats.

A plant is a frozen dataclass of parameters. It names its signals (``inputs``, ``outputs``, ``states``), gives the
linear model that a designer sees (``model()``), and starts a running plant (``start(rng)``), which advances by whole
nanoseconds under a held input, and measures.
"""

from plants.dc_motor import DCMotor, DCMotorRun, LoadTorque
from plants.delayed_states import DelayedStates
from plants.errors import PlantError
from plants.fmu import FMU, FMURun
from plants.omni import Omni
from plants.parts.actuators import Driver
from plants.parts.check import check_plant
from plants.parts.friction import Friction, RubbingAxis
from plants.parts.jump import JumpModel, JumpRates
from plants.parts.linear import DiscreteStateSpace, LinearRun, Signal, StateSpace
from plants.parts.protocols import (
    BeyondModel,
    HasCost,
    HasSensorNoise,
    HasStateDelays,
    HasStateHistory,
    JumpPlant,
    NamesFiles,
    Plant,
    PlantRun,
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
    "NamesFiles",
    "Omni",
    "Plant",
    "PlantError",
    "PlantRun",
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
