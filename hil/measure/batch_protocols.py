"""Protocols of plants, controllers, network laws and measures by which many runs of a loop are computed at once, as a batch.

Each is optional: an experiment with a part that does not fulfil it is run seed by seed, with the same numbers. A class that
fulfils one promises the same bits: every sum in the same order, every draw from the same stream. A measure gets arrays over all
runs instead of one log each.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt
from msgspec import Struct

from design.controllers import LoopModel, Selection
from design.controllers.contract import KnownInBatch
from hil.experiment import Experiment
from hil.measure.signals import Array, Signals
from hil.rig import RigSpec


class BatchView(Struct, frozen=True, kw_only=True):
    """Runs of one experiment, all of the same length, every value finite.

    Args:
        t_s: session time of the slots, s, (slots,).
        outputs: tracked outputs, one array (runs, slots) each.
        reference: of these outputs, (slots, p); the same in every run.
        inputs: applied inputs, without the disturbances, one array (runs, slots) each.
        period_s: sample period, s.
        signals: names and units of outputs and inputs, and which are tracked.
        disturbed_at_s: when the first input disturbance began, s; None without one.
        experiment: what ran.
        rig: what it says of its rig.
        states: of the plant, one array (runs, slots) each; empty unless a measure names their topic.
        packets: how many each sensor node has sent, (nodes, runs); None unless a measure names the topic of the draws.
    """

    t_s: Array
    outputs: tuple[Array, ...]
    reference: Array
    inputs: tuple[Array, ...]
    period_s: float
    signals: Signals
    disturbed_at_s: float | None
    experiment: Experiment
    rig: RigSpec
    states: tuple[Array, ...] = ()
    packets: npt.NDArray[np.int64] | None = None


@runtime_checkable
class BatchMeasure(Protocol):
    """A measure that computes its numbers for many runs at once: a sweep whose measures all do need not make a log of each."""

    def of_batch(self, view: BatchView) -> Mapping[str, Array]:
        """Return its numbers by name, (runs,) each, NaN where `Measure.of` says None; bit for bit those of `Measure.of`."""


class RunningPlants(Protocol):
    """Many runs of one plant, none of which draws a random number."""

    @property
    def state(self) -> Array:
        """States now, (n, runs); a new array after every `advance`."""

    def advance(self, dt_ns: int, u: Array, w: Sequence[float]) -> None:
        """Hold the inputs u (m, runs) and the disturbance w (m,), the same in all runs, for dt_ns."""

    def measure(self) -> Array:
        """Return the outputs now, (p, runs); measuring changes nothing."""


@runtime_checkable
class BatchPlant(Protocol):
    """A plant of which many runs can be computed at once."""

    def start_batch(self, runs: int) -> RunningPlants | None:
        """Return a batch of `runs` plants at time 0; None if that is not possible with these parameters."""


class RunningControllers(Protocol):
    """One controller in many runs; called once a slot, in order."""

    @property
    def selection(self) -> Selection: ...

    @property
    def memory(self) -> int | None:
        """Age of the oldest sample that it takes, slots, asked in every slot; None where the newest samples are enough."""

    def rows(self, k: int, known: KnownInBatch) -> Array:
        """Return the rows of slot k, (rows, m, runs); where a run has not started they mean nothing and change nothing."""


@runtime_checkable
class BatchController(Protocol):
    """A controller that can answer in many runs at once."""

    def start_batch(self, model: LoopModel, runs: int) -> RunningControllers | None:
        """Return a batch of `runs` controllers, ready for slot 0; None if that is not possible with these parameters."""


@runtime_checkable
class BatchAges(Protocol):
    """An age law that draws many paths at once."""

    def ages_of_batch(self, rngs: Iterable[np.random.Generator], runs: int, slots: int) -> npt.NDArray[np.int32]:
        """Return the ages that `start(rng)` draws slot by slot, (slots, runs), one stream per run."""


@runtime_checkable
class NewestOfMany(Protocol):
    """A packet law that says for many runs what a receiver holds."""

    def newest_of_batch(
        self, rngs: Iterable[np.random.Generator], runs: int, slots: int, period_s: float, deadline_s: float
    ) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.bool_]]:
        """Return the slot of the newest received packet in every slot, (slots, runs), and in which runs it is known, (runs,).

        Args:
            rngs: stream of every run; one packet is sent in every slot.
            runs, slots: how many.
            period_s, deadline_s: as `PerPacketLaw.start` takes them.
        """
