"""All runs of a loop at once, slot by slot, bit for bit what `hil.runtime.virtual.simulate` computes seed by seed.

The same random streams per seed, float32 on the wire, the same order of sums. What happens to a packet does not depend on the
plant, so that samples, delays and rows are known beforehand; then one pass over the slots moves all plants. A run in which
safety would trip, or a number leaves the range in which nothing can overflow, is left to the plain engine.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from design.controllers.contract import KnownInBatch
from hil.log.topics import SC, STATE
from hil.measure import measures_of
from hil.measure.batch_protocols import BatchController, BatchMeasure, BatchPlant, BatchView, RunningControllers, RunningPlants
from hil.measure.signals import Array, signals_of
from hil.rig.loop import Loop
from hil.sweeps.batch_delivery import KnownSamples, applied_rows, delivered, law_supports_batch, nodes_of, received, starved

LARGEST = 1e30
"""Beyond it a number is left to the plain engine: its square and its float32 are finite below."""

ENTRIES = 1_000_000
"""Slots times runs that are computed at once: some 80 MB."""

MOST_RUNS = 1000
"""Runs that are computed at once: from there on a run costs the same."""


class BatchResult(Struct, frozen=True, kw_only=True):
    """Runs that were computed at once.

    Args:
        known: which of them are the plain engine's, bit for bit, (runs,).
        outputs: measured outputs, (p, slots, runs).
        inputs: applied inputs without the disturbance, (m, slots, runs).
        reference: (slots, p).
        states: of the plant, (n, slots, runs), where a measure reads them.
        packets: how many each node has sent, (nodes, runs), likewise.
    """

    known: NDArray[np.bool_]
    outputs: Array
    inputs: Array
    reference: Array
    states: Array | None
    packets: NDArray[np.int64] | None


def runs_per_batch(loop: Loop) -> int:
    """Return how many runs of a loop are computed at once."""
    return max(1, min(MOST_RUNS, ENTRIES // loop.experiment.slots))


def supports_batch(loop: Loop) -> bool:
    """Return whether the runs of a loop can be computed at once: its plant, controller and network laws all serve."""
    e = loop.experiment
    return (
        not e.fault
        and not any(shared.table.kind == "can" for shared in loop.rig.media)  # its way back depends on what is sent
        and _sends_all(loop)
        and law_supports_batch(loop.rig.ca_law)
        and isinstance(loop.controller, BatchController)
        and loop.controller.start_batch(loop.model, 1) is not None
        and isinstance(e.plant, BatchPlant)
        and e.plant.start_batch(1) is not None
        and e.limits.passivity is None
    )


def _sends_all(loop: Loop) -> bool:
    """Return whether every output is measured, by nodes that wait for no event."""
    sensors = loop.rig.sensors
    measured = sorted(output for sensor in sensors for output in sensor.outputs)
    ordered = len(sensors) > 1 or sensors[0].outputs == tuple(measured)
    every = measured == list(range(len(loop.experiment.plant.outputs)))
    return every and ordered and all(sensor.trigger.kind == "every-slot" for sensor in sensors)


def swept_at_once(loop: Loop) -> bool:
    """Return whether the runs of a loop can be computed at once, and all measures of its experiment for many runs."""
    return supports_batch(loop) and all(isinstance(measure, BatchMeasure) for measure in measures_of(loop.experiment))


def measured_alone(loop: Loop) -> str:
    """Return which measures keep the runs of a loop from being computed at once, in a sentence; nothing where none does."""
    measures = dict(zip(loop.experiment.report.measures, measures_of(loop.experiment)))
    alone = [name for name, measure in measures.items() if not isinstance(measure, BatchMeasure)]
    if not alone or not supports_batch(loop):
        return ""
    runs = "runs" if len(alone) == 1 else "run"
    return (
        f"{len(measures) - len(alone)} of {len(measures)} measures run at once; {', '.join(alone)} {runs} alone: "
        "without of_batch(view) every run is simulated by itself"
    )


def run_batch(loop: Loop, seeds: Sequence[int], topics: Collection[str] | None = None) -> BatchResult:
    """Run a loop for some seeds at once.

    Args:
        loop: a loop of which `supports_batch` says that it can.
        seeds: one run each; memory grows with their number.
        topics: of which states and packets are kept; those of the experiment's measures by default.
    """
    wanted = {topic for measure in measures_of(loop.experiment) for topic in measure.topics} if topics is None else topics
    plants = loop.experiment.plant.start_batch(len(seeds))  # type: ignore[attr-defined]
    with np.errstate(all="ignore"):  # what overflows is not known
        running = loop.controller.start_batch(loop.model, len(seeds))  # type: ignore[attr-defined]
        return _Slots(loop, seeds, plants, running, wanted).run()


class _Slots:
    """The pass over the slots of some runs."""

    def __init__(
        self, loop: Loop, seeds: Sequence[int], plants: RunningPlants, controllers: RunningControllers, topics: Collection[str]
    ) -> None:
        e, d_max = loop.experiment, loop.model.d_max
        self._loop, self._plants, self._controllers = loop, plants, controllers
        self._slots, self._runs, self._period_ns = e.slots, len(seeds), e.period_ns
        memory = controllers.memory
        sc = delivered(loop, seeds, every_packet=memory is not None or SC.name in topics)
        ca = received(loop.rig.ca_law, seeds, "link.ca", e)
        self._sampled, self._held, self._packets, self._node_of = sc.newest, ca.newest, sc.packets, nodes_of(loop)
        self._samples = None if memory is None else KnownSamples(loop, sc, memory, self._runs)
        self._states = np.empty((len(e.plant.states), e.slots, self._runs)) if STATE.name in topics else None
        self._usable = (ca.newest >= 0) & (np.arange(e.slots, dtype=np.int32)[:, None] - ca.newest <= d_max)
        self._known = sc.known & ca.known & ~starved(self._usable, d_max, e.limits.watchdog_slots)
        self._rows = applied_rows(loop.selection, self._held, d_max, loop.rig.row_sojourns)
        self._ring = d_max + 2
        self._columns = np.arange(self._runs, dtype=np.intp)

    def run(self) -> BatchResult:
        """Move all plants from the first slot to the last."""
        loop, plants, runs, controllers = self._loop, self._plants, self._runs, self._controllers
        begun = np.logical_and.reduce if self._samples is None else np.logical_or.reduce  # of every sample, any node will do
        e, reference, disturbance = loop.experiment, loop.reference().at, loop.disturbance().at
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
            if self._states is not None:
                self._states[:, k] = state
            outputs[:, k] = plants.measure()
            sampled = [node[k] for node in self._sampled]
            started = sampled[0] >= 0 if len(sampled) == 1 else begun([node >= 0 for node in sampled])
            begin = (k % self._ring) * loop.rows
            rows = sent[:, begin * runs : (begin + loop.rows) * runs].reshape(m, loop.rows, runs)
            if started.any() or self._samples is not None:
                found = controllers.rows(k, self._known_in(k, started, sampled, outputs, reference(k)))
                rows[:] = np.where(started, found, 0.0).transpose(1, 0, 2).astype(np.float32)
                np.maximum(peak, np.abs(rows).max(axis=(0, 1)), out=peak)
            else:
                rows[:] = 0.0
            held = self._held[k]
            at = ((held % self._ring) * loop.rows + self._rows[k]) * runs + self._columns
            u = np.where(self._usable[k], sent.take(at, axis=1, mode="clip"), u)
            inputs[:, k] = u
            w = disturbance(k)
        targets = np.array([reference(k) for k in range(self._slots)])
        known = self._known & (peak < LARGEST) & self._allowed(top, inputs)
        return BatchResult(
            known=known, outputs=outputs, inputs=inputs, reference=targets, states=self._states, packets=self._packets
        )  # fmt: skip

    def _known_in(
        self, k: int, started: NDArray[np.bool_], sampled: Sequence[NDArray[np.int32]], outputs: Array, r: Sequence[float]
    ) -> KnownInBatch:
        """Return what the controllers know in a slot: of every sample, or of the newest ones."""
        ages = np.array([k - node for node in sampled], dtype=np.intp)
        if self._samples is None:
            return KnownInBatch(started, ages, self._sample(outputs, sampled), r)
        fresh, held = self._samples.at(k, outputs)
        return KnownInBatch(started, ages, held[0], r, fresh, held)

    def _sample(self, outputs: Array, sampled: Sequence[NDArray[np.int32]]) -> Array:
        """What the newest sensor packets hold, newest sample first, (width, runs); several samples are of one node."""
        found = []
        for j in range(self._loop.samples):
            at = [np.maximum(node - j, 0).astype(np.intp) * self._runs + self._columns for node in sampled]
            found += [y.reshape(-1).take(at[node]) for y, node in zip(outputs, self._node_of)]
        return np.array(found, dtype=np.float32).astype(np.float64)

    def _allowed(self, top: Array, inputs: Array) -> NDArray[np.bool_]:
        """Return in which runs safety did not trip, (runs,)."""
        limits, names = self._loop.experiment.limits, [s.name for s in self._loop.experiment.plant.states]
        allowed = [(top < LARGEST).all(axis=0)]
        allowed += [top[names.index(name)] <= bound for name, bound in limits.state.items()]
        allowed += [(np.abs(u) <= limit).all(axis=0) for u, limit in zip(inputs, limits.input or ())]
        return np.asarray(np.logical_and.reduce(allowed), dtype=np.bool_)


def view_of_batch(loop: Loop, runs: BatchResult) -> BatchView:
    """Return the known runs as measures see them."""
    e = loop.experiment
    names = [signal.name for signal in e.plant.outputs]
    tracked = [names.index(name) for name in signals_of(e.plant).tracked]
    return BatchView(
        t_s=np.arange(e.slots, dtype=np.int64) * e.period_ns / 1e9,
        outputs=tuple(np.ascontiguousarray(runs.outputs[c][:, runs.known].T) for c in tracked),
        reference=np.ascontiguousarray(runs.reference[:, tracked]),
        inputs=tuple(np.ascontiguousarray(u[:, runs.known].T) for u in runs.inputs),
        period_s=float(e.period),
        signals=signals_of(e.plant),
        disturbed_at_s=min((float(p.at) for p in e.disturbance), default=None),
        experiment=e,
        rig=loop.rig,
        states=() if runs.states is None else tuple(np.ascontiguousarray(x[:, runs.known].T) for x in runs.states),
        packets=None if runs.packets is None else runs.packets[:, runs.known],
    )
