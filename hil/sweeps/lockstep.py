"""All runs of a loop at once, slot by slot, bit for bit what `hil.session.simulate` computes seed by seed.

The same random streams per seed, float32 on the wire, the same order of sums. What happens to a packet does not depend on the
plant, so that samples, delays and rows are known beforehand; then one pass over the slots moves all plants. A run in which
safety would trip, or a number leaves the range in which nothing can overflow, is left to the plain engine.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from hil.compose.loop import Loop
from hil.measure.many import ManyView, MeasureOfMany
from hil.measure.measure import measures_of
from hil.measure.signals import signals_of
from hil.sweeps.delays_of_many import applied_rows, drawn_ages, lawful, newest
from hil.sweeps.many import ControllerOfMany, Matrix, PlantOfMany, RunningControllers, RunningPlants
from transport.laws.protocols import AgeLaw

LARGEST = 1e30
"""Beyond it a number is left to the plain engine: its square and its float32 are finite below."""

ENTRIES = 1_000_000
"""Slots times runs that are computed at once: some 80 MB."""

MOST_RUNS = 1000
"""Runs that are computed at once: from there on a run costs the same."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Together:
    """Runs that were computed at once.

    Args:
        known: which of them are the plain engine's, bit for bit, (runs,).
        outputs: measured outputs, (p, slots, runs).
        inputs: applied inputs without the disturbance, (m, slots, runs).
        reference: (slots, p).
    """

    known: NDArray[np.bool_]
    outputs: Matrix
    inputs: Matrix
    reference: Matrix


def chunk_runs(loop: Loop) -> int:
    """Return how many runs of a loop are computed at once."""
    return max(1, min(MOST_RUNS, ENTRIES // loop.experiment.ticks))


def in_lockstep(loop: Loop) -> bool:
    """Return whether the runs of a loop can be computed at once: its plant, controller and network laws all serve."""
    e, laws = loop.experiment, (loop.sensors[0].law, loop.ca_law)
    return (
        not e.fault
        and _sends_all(loop)
        and all(law.family == "age" for law in laws)
        and isinstance(loop.controller, ControllerOfMany)
        and isinstance(e.plant, PlantOfMany)
        and e.plant.start_many(1) is not None
        and e.limits.passivity is None
    )


def _sends_all(loop: Loop) -> bool:
    """Return whether one node measures every output and sends in every slot: several wait for each other, run by run."""
    first = loop.sensors[0]  # the only one, where it measures every output
    every = first.outputs == tuple(range(len(loop.experiment.plant.outputs)))
    return every and not loop.media and first.trigger.kind == "every-slot" and first.clock.every == 1


def measures_in_lockstep(loop: Loop) -> bool:
    """Return whether all measures of an experiment can be computed for many runs at once."""
    return all(isinstance(measure, MeasureOfMany) for measure in measures_of(loop.experiment))


def run_together(loop: Loop, seeds: Sequence[int]) -> Together:
    """Run a loop for some seeds at once.

    Args:
        loop: a loop of which `in_lockstep` says that it can.
        seeds: one run each; memory grows with their number.
    """
    plants = loop.experiment.plant.start_many(len(seeds))  # type: ignore[attr-defined]
    with np.errstate(all="ignore"):  # what overflows is not known
        return _Slots(loop, seeds, plants, loop.controller.start_many(loop.model, len(seeds))).run()  # type: ignore[attr-defined]


class _Slots:
    """The pass over the slots of some runs."""

    def __init__(self, loop: Loop, seeds: Sequence[int], plants: RunningPlants, controllers: RunningControllers) -> None:
        e, d_max = loop.experiment, loop.model.d_max
        self._loop, self._plants, self._controllers = loop, plants, controllers
        self._slots, self._runs, self._period_ns = e.ticks, len(seeds), e.period_ns
        sc_law, ca_law = cast("tuple[AgeLaw, AgeLaw]", (loop.sensors[0].law, loop.ca_law))  # `in_lockstep` asked their family
        sc = drawn_ages(sc_law, seeds, loop.sensors[0].stream, e.ticks)
        ca = drawn_ages(ca_law, seeds, "link.ca", e.ticks)
        self._known = lawful(sc_law, sc) & lawful(ca_law, ca)
        self._sampled, self._held = newest(sc), newest(ca)
        self._rows = applied_rows(loop.selection, self._held, d_max)
        self._ring = d_max + 2
        self._columns = np.arange(self._runs, dtype=np.intp)

    def run(self) -> Together:
        """Move all plants from the first slot to the last."""
        loop, plants, controllers, runs = self._loop, self._plants, self._controllers, self._runs
        e, reference, disturbance = loop.experiment, loop.reference(), loop.disturbance()
        p, m = len(e.plant.outputs), len(e.plant.inputs)
        outputs, inputs = np.empty((p, self._slots, runs)), np.zeros((m, self._slots, runs))
        sent = np.zeros((m, self._ring * loop.rows * runs))  # rows of the last packets, as the wire holds them
        peak, top = np.zeros(runs), np.zeros(plants.state.shape)
        u, w = np.zeros((m, runs)), (0.0,) * m
        for k in range(self._slots):
            if k:
                plants.advance(self._period_ns, u, w)
            state = plants.state
            np.maximum(top, np.abs(state), out=top)
            outputs[:, k] = plants.measure()
            sampled = self._sampled[k]
            started = sampled >= 0
            begin = (k % self._ring) * loop.rows
            rows = sent[:, begin * runs : (begin + loop.rows) * runs].reshape(m, loop.rows, runs)
            if started.any():
                found = controllers.rows(k, started, k - sampled, self._sample(outputs, sampled), reference(k))
                rows[:] = np.where(started, found, 0.0).transpose(1, 0, 2).astype(np.float32)
                np.maximum(peak, np.abs(rows).max(axis=(0, 1)), out=peak)
            else:
                rows[:] = 0.0
            held = self._held[k]
            at = ((held % self._ring) * loop.rows + self._rows[k]) * runs + self._columns
            u = np.where(held >= 0, sent.take(at, axis=1, mode="clip"), 0.0)
            inputs[:, k] = u
            w = disturbance(k)
        targets = np.array([reference(k) for k in range(self._slots)])
        known = self._known & (peak < LARGEST) & self._allowed(top, inputs)
        return Together(known=known, outputs=outputs, inputs=inputs, reference=targets)

    def _sample(self, outputs: Matrix, sampled: NDArray[np.int32]) -> Matrix:
        """What the newest sensor packet holds, newest sample first, (width, runs)."""
        found = []
        for j in range(self._loop.samples):
            at = np.maximum(sampled - j, 0).astype(np.intp) * self._runs + self._columns
            found += [y.reshape(-1).take(at) for y in outputs]
        return np.array(found, dtype=np.float32).astype(np.float64)

    def _allowed(self, top: Matrix, inputs: Matrix) -> NDArray[np.bool_]:
        """Return in which runs safety did not trip, (runs,)."""
        limits, names = self._loop.experiment.limits, [s.name for s in self._loop.experiment.plant.states]
        allowed = [(top < LARGEST).all(axis=0)]
        allowed += [top[names.index(name)] <= bound for name, bound in limits.state.items()]
        allowed += [(np.abs(u) <= limit).all(axis=0) for u, limit in zip(inputs, limits.input or ())]
        return np.asarray(np.logical_and.reduce(allowed), dtype=np.bool_)


def view_of_many(loop: Loop, runs: Together) -> ManyView:
    """Return the known runs as measures see them."""
    e = loop.experiment
    names = [signal.name for signal in e.plant.outputs]
    tracked = [names.index(name) for name in signals_of(e.plant).tracked]
    return ManyView(
        t_s=np.arange(e.ticks, dtype=np.int64) * e.period_ns / 1e9,
        outputs=tuple(np.ascontiguousarray(runs.outputs[c][:, runs.known].T) for c in tracked),
        reference=np.ascontiguousarray(runs.reference[:, tracked]),
        inputs=tuple(np.ascontiguousarray(u[:, runs.known].T) for u in runs.inputs),
        period_s=float(e.period),
        signals=signals_of(e.plant),
        disturbed_at_s=min((float(p.at) for p in e.disturbance), default=None),
    )
