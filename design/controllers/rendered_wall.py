"""What a controller that renders a wall is seen as by who judges or draws its loop; a loop without a wall imports no wall."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from design.controllers.contract import LoopModel, RunningController, Selection

if TYPE_CHECKING:
    from design.controllers.coupler import Coupler
    from design.controllers.wall import Wall

Array = NDArray[np.float64]
Matrix = tuple[tuple[float, ...], ...]


@runtime_checkable
class WallController(Protocol):
    """A controller that renders a wall through a coupler; over a device with a hand its loop can be certified passive."""

    wall: Wall
    coupler: Coupler
    equalise: bool
    """Whether both ends wait until the largest delay has passed."""

    def start(self, model: LoopModel) -> RunningController: ...


@runtime_checkable
class ModelFollower(Protocol):
    """A controller that renders a wall by following a model; in contact it is linear, one map per material."""

    wall: Wall
    feedback: Matrix

    def start(self, model: LoopModel) -> LinearInContact: ...


@runtime_checkable
class LinearInContact(Protocol):
    """A running controller that is linear while the device is in contact."""

    selection: Selection

    @property
    def order(self) -> int:
        """Number of its states."""
        ...

    def linear(self, state: Array, place: float, material: int) -> tuple[float, Array]:
        """Return the force and the next state, for a state, the delayed place, and a material."""
        ...
