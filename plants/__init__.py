"""What is driven: the plants of a rig, each propagated exactly through time in plain floats.

A plant is a frozen dataclass of parameters. It names its signals (``inputs``, ``outputs``, ``states``), gives the
linear model that a designer sees (``model()``), and starts a running plant (``start(rng)``), which advances by whole
nanoseconds under a held input, and measures.
"""

from plants.actuators import Driver
from plants.dc_motor import DCMotor, DCMotorRun, LoadTorque
from plants.errors import PlantError
from plants.friction import Friction, RubbingAxis
from plants.linear import DiscreteStateSpace, LinearRun, Signal, StateSpace
from plants.omni import Omni
from plants.sensors import Encoder
from plants.vtol import VTOL

__all__ = [
    "VTOL",
    "DCMotor",
    "DCMotorRun",
    "DiscreteStateSpace",
    "Driver",
    "Encoder",
    "Friction",
    "LinearRun",
    "LoadTorque",
    "Omni",
    "PlantError",
    "RubbingAxis",
    "Signal",
    "StateSpace",
]
