"""Many runs of one experiment with what measures need of them: arrays over all runs instead of one log each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, TypeAlias, runtime_checkable

import numpy as np
import numpy.typing as npt

from hil.experiment import Experiment
from hil.measure.signals import Signals
from hil.rig.spec import RigSpec

BatchValues: TypeAlias = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class BatchView:
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

    t_s: BatchValues
    outputs: tuple[BatchValues, ...]
    reference: BatchValues
    inputs: tuple[BatchValues, ...]
    period_s: float
    signals: Signals
    disturbed_at_s: float | None
    experiment: Experiment
    rig: RigSpec
    states: tuple[BatchValues, ...] = ()
    packets: npt.NDArray[np.int64] | None = None


@runtime_checkable
class BatchMeasure(Protocol):
    """A measure that computes its numbers for many runs at once: a sweep whose measures all do need not make a log of each."""

    def of_batch(self, view: BatchView) -> Mapping[str, BatchValues]:
        """Return its numbers by name, (runs,) each, NaN where `Measure.of` says None; bit for bit those of `Measure.of`."""
        ...
