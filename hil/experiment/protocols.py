"""What the plug-ins of an experiment fulfil: the protocols by which the loop is composed, run and certified.

Controllers have theirs in :mod:`design.controllers.contract`, network laws in :mod:`transport.laws.protocols`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np

from design.controllers import LoopModel, RunningController
from plants.parts.jump import JumpModel, JumpRates
from plants.parts.linear import Signal, StateSpace

if TYPE_CHECKING:
    from design.requests.task import DesignTask


class PlantRun(Protocol):
    """A plant that runs; its time is what it was advanced by."""

    def advance(self, dt_ns: int, u: Sequence[float], w: Sequence[float] = ()) -> None:
        """Hold u + w for dt_ns."""
        ...

    def measure(self) -> tuple[float, ...]:
        """Return the outputs now; measuring changes nothing."""
        ...

    @property
    def state(self) -> tuple[float, ...]: ...

    @property
    def applied(self) -> tuple[float, ...]: ...


@runtime_checkable
class Plant(Protocol):
    """Parameters of a plant: a frozen dataclass that an experiment's ``[plant]`` table fills."""

    @property
    def inputs(self) -> tuple[Signal, ...]: ...

    @property
    def outputs(self) -> tuple[Signal, ...]: ...

    @property
    def states(self) -> tuple[Signal, ...]: ...

    def model(self) -> StateSpace:
        """Return the linear model that a designer sees."""
        ...

    def start(self, rng: np.random.Generator) -> PlantRun:
        """Return the plant at time 0; all randomness comes from ``rng``."""
        ...


@runtime_checkable
class JumpPlant(Plant, Protocol):
    """A plant whose matrices jump at random instants; it measures its state and, last, the mode seen (1, 2, ...)."""

    def jump_system(self) -> JumpModel:
        """Return the matrices of every mode, as they run."""
        ...

    def jump_process(self) -> JumpRates:
        """Return the rates of the modes, as they run."""
        ...


@runtime_checkable
class BeyondModel(Protocol):
    """A plant that says what acts on it and is not in its model; a claim about the model is then undecided for the plant."""

    def beyond_model(self) -> tuple[str, ...]:
        """Return what it has beyond its model, each a noun phrase; empty: the model is the plant."""
        ...


class NamedController(Protocol):
    """A controller that says under which plug-in name the log's experiment makes it again."""

    @property
    def kind(self) -> str: ...

    def start(self, model: LoopModel) -> RunningController: ...


@runtime_checkable
class Designer(Protocol):
    """A ``[controller]`` table that says what is to be achieved; what runs is what it solves to.

    It returns gains and nothing else: whether their loop is certified is said by :mod:`hil.compose.certify` alone.
    """

    def solve(self, task: DesignTask) -> NamedController:
        """Return the controller that runs.

        Raises:
            ValueError: a field that does not fit the loop; the message starts with the field.
            DesignError: no gains meet the request; the message has the number that decides it.
        """
        ...
