"""What plants, controllers and network laws fulfil so that many runs of a loop can be computed at once.

Each is optional: what an experiment names and does not fulfil it is run seed by seed, with the same numbers. Who fulfils one
promises the same bits: every sum in the same order, every draw from the same stream.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from design.controllers import LoopModel, Selection
from design.controllers.contract import KnownInBatch

Matrix = NDArray[np.float64]


class RunningPlants(Protocol):
    """Many runs of one plant, none of which draws a random number."""

    @property
    def state(self) -> Matrix:
        """States now, (n, runs); a new array after every `advance`."""
        ...

    def advance(self, dt_ns: int, u: Matrix, w: Sequence[float]) -> None:
        """Hold the inputs u (m, runs) and the disturbance w (m,), the same in all runs, for dt_ns."""
        ...

    def measure(self) -> Matrix:
        """Return the outputs now, (p, runs); measuring changes nothing."""
        ...


@runtime_checkable
class BatchPlant(Protocol):
    """A plant of which many runs can be computed at once."""

    def start_batch(self, runs: int) -> RunningPlants | None:
        """Return so many of them at time 0; None if it cannot with these parameters."""
        ...


class RunningControllers(Protocol):
    """One controller in many runs; called once a slot, in order."""

    @property
    def selection(self) -> Selection: ...

    @property
    def memory(self) -> int | None:
        """Age of the oldest sample that it takes, slots, asked in every slot; None where the newest samples are enough."""
        ...

    def rows(self, k: int, known: KnownInBatch) -> Matrix:
        """Return the rows of slot k, (rows, m, runs); where a run has not started they mean nothing and change nothing."""
        ...


@runtime_checkable
class BatchController(Protocol):
    """A controller that can answer in many runs at once."""

    def start_batch(self, model: LoopModel, runs: int) -> RunningControllers | None:
        """Return so many of them, ready for slot 0; None if it cannot with these parameters."""
        ...


@runtime_checkable
class BatchAges(Protocol):
    """An age law that draws many paths at once."""

    def ages_of_batch(self, rngs: Iterable[np.random.Generator], runs: int, slots: int) -> NDArray[np.int32]:
        """Return the ages that `start(rng)` draws slot by slot, (slots, runs), one stream per run."""
        ...


@runtime_checkable
class NewestOfMany(Protocol):
    """A packet law that says for many runs what a receiver holds."""

    def newest_of_batch(
        self, rngs: Iterable[np.random.Generator], runs: int, slots: int, period_s: float, deadline_s: float
    ) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
        """Return the slot of the newest packet by every slot, (slots, runs), and of which runs it is known, (runs,).

        Args:
            rngs: stream of every run; one packet is sent in every slot.
            runs, slots: how many.
            period_s, deadline_s: as `PerPacketLaw.start` takes them.
        """
        ...
