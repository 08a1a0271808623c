"""What is driven: the plants of a rig, each propagated exactly through time in plain floats.

A plant is a frozen dataclass of parameters. It names its signals (``inputs``, ``outputs``, ``states``), gives the
linear model that a designer sees (``model()``), and starts a running plant (``start(rng)``), which advances by whole
nanoseconds under a held input, and measures.

Importing this package costs nothing: each name brings its module when it is first used, so a run pays for its own plant alone.
"""

from __future__ import annotations

from importlib import import_module

TYPE_CHECKING = False  # the import of typing takes time
if TYPE_CHECKING:
    from plants.dc_motor import DCMotor as DCMotor
    from plants.dc_motor import LoadTorque as LoadTorque
    from plants.delayed_states import DelayedStates as DelayedStates
    from plants.errors import PlantError as PlantError
    from plants.fmu import FMU as FMU
    from plants.fmu_run import FMURun as FMURun
    from plants.omni import Omni as Omni
    from plants.parts import DiscreteStateSpace as DiscreteStateSpace
    from plants.parts import Signal as Signal
    from plants.parts import StateSpace as StateSpace
    from plants.parts.actuators import Driver as Driver
    from plants.parts.actuators import Encoder as Encoder
    from plants.parts.actuators import Friction as Friction
    from plants.parts.check import check_plant as check_plant
    from plants.parts.delayed_run import DelayedVTOLRun as DelayedVTOLRun
    from plants.parts.flow import JumpProcess as JumpProcess
    from plants.parts.linear_run import LinearRun as LinearRun
    from plants.parts.motor_run import DCMotorRun as DCMotorRun
    from plants.parts.protocols import BeyondModel as BeyondModel
    from plants.parts.protocols import Departure as Departure
    from plants.parts.protocols import GoesOn as GoesOn
    from plants.parts.protocols import HasCost as HasCost
    from plants.parts.protocols import HasDepartures as HasDepartures
    from plants.parts.protocols import HasOwnInputs as HasOwnInputs
    from plants.parts.protocols import HasPassiveElements as HasPassiveElements
    from plants.parts.protocols import HasSensorNoise as HasSensorNoise
    from plants.parts.protocols import HasStateDelays as HasStateDelays
    from plants.parts.protocols import HasStateHistory as HasStateHistory
    from plants.parts.protocols import JumpPlant as JumpPlant
    from plants.parts.protocols import MovesOtherwise as MovesOtherwise
    from plants.parts.protocols import PassiveElement as PassiveElement
    from plants.parts.protocols import Plant as Plant
    from plants.parts.protocols import PlantRun as PlantRun
    from plants.parts.protocols import ReferencesFiles as ReferencesFiles
    from plants.parts.rubbing_axis import RubbingAxis as RubbingAxis
    from plants.parts.semi_markov import JumpModel as JumpModel
    from plants.parts.semi_markov import JumpRates as JumpRates
    from plants.parts.semi_markov import TransitionRates as TransitionRates
    from plants.state_space import LinearPlant as LinearPlant
    from plants.state_space import TransferFunction as TransferFunction
    from plants.state_space import from_control as from_control
    from plants.state_space import to_control as to_control
    from plants.switched_example import SwitchedExample as SwitchedExample
    from plants.switched_example import SwitchedExampleRun as SwitchedExampleRun
    from plants.vtol import VTOL as VTOL
    from plants.vtol import DelayedVTOL as DelayedVTOL
    from plants.vtol import vtol_matrices as vtol_matrices
    from plants.vtol_fault import FaultyVTOL as FaultyVTOL
    from plants.vtol_fault import FaultyVTOLRun as FaultyVTOLRun

with open(f"{__path__[0]}/__init__.py", encoding="utf-8") as _face:
    _HOMES = {words[3]: words[1] for words in map(str.split, _face) if words[0:1] + words[4:5] == ["from", "as"]}
"""Module of each public name, as the imports for type checkers have them."""

__all__ = sorted(_HOMES)  # noqa: PLE0605


if not TYPE_CHECKING:

    def __getattr__(name: str) -> object:
        if name not in _HOMES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
