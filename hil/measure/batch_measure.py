"""Many runs of one experiment with what measures need of them: arrays over all runs instead of one log each.

What they give is bit for bit what the measures of a single run do, such as `tracking_metrics`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol, TypeAlias, runtime_checkable

import numpy as np
import numpy.typing as npt
from msgspec import Struct

from hil.experiment import Experiment
from hil.measure.signals import AFTER_S, SETTLED_SHARE, SETTLING_BAND, STEADY_SHARE, Signals, target_of
from hil.rig.spec import RigSpec

BatchValues: TypeAlias = npt.NDArray[np.float64]


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


def tracking_of_batch(view: BatchView) -> dict[str, BatchValues]:
    """Return the numbers of `hil.measure.tracking.tracking_metrics` for many runs, (runs,) each, NaN for None.

    Args:
        view: the runs, at least one slot long.
    """
    t, reference, runs, n = view.t_s, view.reference, len(view.inputs[0]), len(view.t_s)
    nothing = np.full(runs, np.nan)
    target = target_of(reference)
    errors = [y - c for y, c in zip(view.outputs, target.T)]
    squared = errors[0] ** 2 if len(errors) == 1 else np.sum(np.stack(errors, axis=-1) ** 2, axis=-1)
    begin = int(np.searchsorted(t, AFTER_S - 1e-9))
    last = max(round(STEADY_SHARE * n), 1)
    found = {
        "sse": view.period_s * squared.sum(axis=1),
        "sse_after_5s": view.period_s * squared[:, begin:].sum(axis=1) if begin < n else nothing,
        "overshoot": nothing,
        "settling_time_s": nothing,
        "steady_state_error": _worst([error[:, -last:].mean(axis=1) for error in errors]),
        "max_abs_u": np.maximum.reduce([np.abs(u).max(axis=1) for u in view.inputs]),
    }
    changes = np.flatnonzero(np.any(reference[1:] != reference[:-1], axis=1)) + 1
    if changes.size:
        first, end = int(changes[0]), int(changes[1]) if changes.size > 1 else n
        if view.disturbed_at_s is not None and view.disturbed_at_s > t[first]:
            end = min(end, int(np.searchsorted(t, view.disturbed_at_s - 1e-9)))
        step = reference[first] - reference[first - 1]
        moved = [(error[:, first:end], s) for error, s in zip(errors, step) if s != 0.0]
        if moved and end > first:
            beyond = np.maximum.reduce([(error / s).max(axis=1) for error, s in moved])
            found["overshoot"] = 100.0 * np.maximum(beyond, 0.0)
            found["settling_time_s"] = _settling(t[first:end], moved)
    return found


def _settling(t: BatchValues, moved: list[tuple[BatchValues, float]]) -> BatchValues:
    inside = np.logical_and.reduce([np.abs(error) <= SETTLING_BAND * abs(step) for error, step in moved])
    after = inside.shape[1] - np.argmin(inside[:, ::-1], axis=1)  # first slot after the last one outside
    after[inside.all(axis=1)] = 0
    stays = inside[:, -max(round(SETTLED_SHARE * len(t)), 1) :].all(axis=1)
    return np.where(stays, t[np.minimum(after, len(t) - 1)] - t[0], np.nan)


def _worst(means: list[BatchValues]) -> BatchValues:
    worst = means[0]
    for mean in means[1:]:
        worst = np.where(np.abs(mean) > np.abs(worst), mean, worst)
    return worst
