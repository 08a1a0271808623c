"""What controllers and actuators receive in many runs at once: known before a plant moves, as no node waits for an event.

Where every node has a channel of its own and only the newest packet counts, it is computed for all runs at once. Where nodes
share a medium, have clocks, or every packet counts, the medium of a session is asked run by run, with packets that carry nothing.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import cast

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from hil.experiment import Experiment
from hil.measure.batch_protocols import BatchAges, NewestOfMany
from hil.rig.loop import Loop
from hil.runtime.nodes import rng_for
from hil.runtime.nodes.network import clock_of, sensor_medium_of
from transport.draws import DELIVERED, DISORDERED, LOST, SUPERSEDED
from transport.laws import AgeLaw, GapLaw, NetworkLaw

Slots = NDArray[np.int32]


class Received(Struct, frozen=True, kw_only=True):
    """What the receiver of one direction holds.

    Args:
        newest: slot of the newest packet that has come, (slots, runs), -1 before the first.
        known: in which runs, (runs,).
    """

    newest: Slots
    known: NDArray[np.bool_]


def law_supports_batch(law: NetworkLaw) -> bool:
    """Return whether what comes over a network law can be computed for many runs at once."""
    return law.family == "age" or isinstance(law, NewestOfMany)


def received(law: NetworkLaw, seeds: Sequence[int], stream: str, experiment: Experiment) -> Received:
    """Return what comes of packets of which one leaves in every slot.

    Args:
        law: of which `law_supports_batch` says so.
        seeds: one run each.
        stream: name of the law's random stream.
        experiment: says how many slots, and when they close.
    """
    e = experiment
    if isinstance(law, NewestOfMany):
        rngs = (rng_for(seed, stream) for seed in seeds)
        period_s = float(e.period)
        found, known = law.newest_of_batch(rngs, len(seeds), e.slots, period_s, e.timing.deadline * period_s)
        return Received(newest=found, known=known)
    age_law = cast(AgeLaw, law)
    ages = drawn_ages(age_law, seeds, stream, e.slots)
    return Received(newest=newest(ages), known=lawful(age_law, ages))


def drawn_ages(law: AgeLaw, seeds: Sequence[int], stream: str, slots: int) -> Slots:
    """Return the ages that an age law draws in the runs of some seeds, (slots, runs)."""
    rngs: Iterable[np.random.Generator] = (rng_for(seed, stream) for seed in seeds)
    if isinstance(law, BatchAges):
        return law.ages_of_batch(rngs, len(seeds), slots)
    drawn = np.empty((slots, len(seeds)), dtype=np.int32)
    for column, rng in zip(drawn.T, rngs):
        draw = law.start(rng).draw
        column[:] = [draw()[1] for _ in range(slots)]
    return drawn


def lawful(law: AgeLaw, ages: Slots) -> NDArray[np.bool_]:
    """Return which runs a law keeps its word in, (runs,): no age beyond its largest, and no gap unless it says so."""
    good: NDArray[np.bool_] = np.asarray(((ages >= 0) & (ages <= law.max_age)).all(axis=0))
    if isinstance(law, GapLaw) and not law.allow_gaps:
        good &= np.asarray((ages[1:] <= ages[:-1] + 1).all(axis=0))
    return good


def newest(ages: Slots) -> Slots:
    """Return the slot of the newest packet that has come, (slots, runs), -1 before the first.

    >>> newest(np.array([[1], [0], [2], [1]], dtype=np.int32)).ravel().tolist()
    [-1, 1, 1, 2]
    """
    sent = np.arange(len(ages), dtype=np.int32)[:, None] - ages
    return np.maximum.accumulate(np.maximum(sent, -1), axis=0)


def starved(usable: NDArray[np.bool_], d_max: int, watchdog_slots: int) -> NDArray[np.bool_]:
    """Return in which runs the watchdog trips, (runs,); see `hil.runtime.nodes.safety.Safety.starved`.

    Args:
        usable: whether the actuator holds a packet that its rows cover, (slots, runs).
        d_max: largest age that they cover; up to that slot nothing is missing.
        watchdog_slots: so many slots in a row without one trip it.

    >>> starved(np.array([[0, 1], [1, 1], [0, 0], [0, 1], [0, 0]], dtype=bool), 1, 3).tolist()
    [True, False]
    """
    waits = ~usable
    waits[: d_max + 1] = False
    missing = np.cumsum(waits, axis=0, dtype=np.int32)
    fed = np.maximum.accumulate(np.where(waits, 0, missing), axis=0)
    return np.asarray(((missing - fed) >= watchdog_slots).any(axis=0))


def applied_rows(selection: str, packet_slots: Slots, d_max: int, row_sojourns: int = 1) -> Slots:
    """Return which row of the packet held is applied, (slots, runs); see `hil.runtime.nodes.actuator_node.row_index`.

    Args:
        selection: the rule.
        packet_slots: slot in which the packet was generated, -1 for none (its row means nothing).
        d_max: largest age that the rows cover.
        row_sojourns: lengths of stay at d that have a row each.
    """
    k = np.arange(len(packet_slots), dtype=np.int32)[:, None]
    d = np.where(packet_slots >= 0, k - packet_slots, -1)
    if selection == "constant":
        return np.zeros_like(packet_slots)
    if selection == "applied":
        changed = np.concatenate([np.ones_like(d[:1], dtype=np.bool_), d[1:] != d[:-1]])
        stayed = k - np.maximum.accumulate(np.where(changed, k, 0), axis=0)
        return np.asarray(np.maximum(d, 0) * row_sojourns + np.minimum(stayed, row_sojourns - 1), dtype=np.int32)
    asked = np.maximum(packet_slots - 1 if selection == "previous" else packet_slots, 0)
    at = np.take_along_axis(d, asked, axis=0)
    seen = np.where((at >= 0) & (at <= d_max), at, d_max)
    return np.asarray(seen * (d_max + 1) + np.maximum(d, 0) if selection == "both" else seen, dtype=np.int32)


_TOLD = frozenset((DELIVERED, DISORDERED, SUPERSEDED, LOST))
"""Fates that say that a packet was sent, each once; see `hil.measure.network_paths.sent_packets`."""

Arrivals = tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.int32]]
"""Of one slot: run, node, and the slot in which the packet was sent, of everything that arrives, in order."""


class Delivered(Struct, frozen=True, kw_only=True):
    """What comes of the sensor nodes.

    Args:
        newest: of every node, slot of the newest packet that has come, (slots, runs), -1 before the first.
        known: in which runs, (runs,).
        arrivals: slot by slot; None where they were not asked for.
        packets: how many each node has sent whose fate is known, (nodes, runs); likewise.
    """

    newest: Sequence[Slots]
    known: NDArray[np.bool_]
    arrivals: Sequence[Arrivals] | None = None
    packets: NDArray[np.int64] | None = None


def delivered(loop: Loop, seeds: Sequence[int], *, every_packet: bool) -> Delivered:
    """Return what the controller receives in the runs of some seeds.

    Args:
        loop: whose nodes wait for no event.
        seeds: one run each.
        every_packet: whether arrivals and numbers of packets are wanted.
    """
    of_its_law = not loop.rig.media and all(law_supports_batch(s.law) and s.clock.every == 1 for s in loop.rig.sensors)
    if of_its_law and not every_packet:  # what comes of every node follows from its law alone, for all runs at once
        ways = [received(s.law, seeds, s.stream, loop.experiment) for s in loop.rig.sensors]
        return Delivered(newest=[w.newest for w in ways], known=np.logical_and.reduce([w.known for w in ways]))
    if len(seeds) > 1 and _certain(loop):
        return _repeated(delivered(loop, seeds[:1], every_packet=every_packet), len(seeds))
    e, nodes, runs = loop.experiment, len(loop.rig.sensors), len(seeds)
    newest = [np.full((e.slots, runs), -1, dtype=np.int32) for _ in range(nodes)]
    packets, known = np.zeros((nodes, runs), dtype=np.int64), np.ones(runs, dtype=np.bool_)
    came: list[list[tuple[int, int, int]]] = [[] for _ in range(e.slots)]
    for run, seed in enumerate(seeds):
        last = _one_run(loop, seed, run, came, packets)
        known[run] = last == e.slots - 1  # else the log would say that the run was shorter
    arrivals = []
    for k, found in enumerate(came):
        of_run, of_node, sent = (np.array(column) for column in zip(*found)) if found else ((np.empty(0, dtype=np.intp),) * 3)
        for node, own in enumerate(newest):
            there = of_node == node
            np.maximum.at(own[k], of_run[there], sent[there].astype(np.int32))
        arrivals.append((of_run.astype(np.intp), of_node.astype(np.intp), sent.astype(np.int32)))
    newest = [np.maximum.accumulate(own, axis=0) for own in newest]
    return Delivered(newest=newest, known=known, arrivals=arrivals, packets=packets)


def _certain(loop: Loop) -> bool:
    """Return whether chance decides nothing of what is delivered: a fixed order, constant delays, no losses."""
    return (
        None not in loop.model.nodes.delays
        and all(shared.table.kind != "random" and shared.table.loss == 0.0 for shared in loop.rig.media)
        and not any(sensor.clock.drawn for sensor in loop.rig.sensors)
    )


def _repeated(one: Delivered, runs: int) -> Delivered:
    """Return what is delivered in one run as that of many."""
    every = np.arange(runs, dtype=np.intp)
    return Delivered(
        newest=[np.repeat(own, runs, axis=1) for own in one.newest],
        known=np.repeat(one.known, runs),
        arrivals=[
            (np.tile(every, len(node)), np.repeat(node, runs), np.repeat(sent, runs)) for _, node, sent in one.arrivals or ()
        ],
        packets=None if one.packets is None else np.repeat(one.packets, runs, axis=1),
    )


def _one_run(loop: Loop, seed: int, run: int, arrivals: Sequence[list[tuple[int, int, int]]], packets: NDArray[np.int64]) -> int:
    """Ask the medium of one run, slot by slot, as a rig does; return the last slot of which it said something."""
    medium = sensor_medium_of(loop, seed)
    clocks = [clock_of(sensor, seed) for sensor in loop.rig.sensors]
    last = -1
    for k in range(loop.rig.slots):
        for node, clock in enumerate(clocks):
            turn = medium.may_send(node, k)
            if (clock is None or clock.due(k)) and turn:
                medium.offer(node, k, None)
        for node, (draws, arrived) in enumerate(medium.collect(k)):
            for draw in draws:
                last = max(last, draw.slot)
                packets[node, run] += draw.reason in _TOLD
            arrivals[k] += [(run, node, sent) for sent, _ in arrived]
    return last


class KnownSamples:
    """The samples that have come and are not older than a controller's memory, in many runs; see `SampleHistory`.

    Args:
        loop: the loop.
        delivered: with its arrivals.
        memory: age of the oldest sample, slots.
        runs: how many.
    """

    def __init__(self, loop: Loop, delivered: Delivered, memory: int, runs: int) -> None:
        self._arrivals, self._memory, self._runs = delivered.arrivals or (), memory, runs
        self._buffers = np.array([sensor.buffer for sensor in loop.rig.sensors])
        self._node_of = nodes_of(loop)
        self._have = np.zeros((memory + 1, len(loop.rig.sensors), runs), dtype=np.bool_)
        self._last = np.full((len(loop.rig.sensors), runs), -1, dtype=np.int64)
        self._columns = np.arange(runs, dtype=np.intp)

    def at(self, k: int, outputs: NDArray[np.float64]) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
        """Return what is known in slot k; to be called in every slot, in order.

        Args:
            k: slot.
            outputs: as measured, (p, slots, runs).

        Returns:
            fresh: whether the sample of slot k - j of a node has come, (memory + 1, nodes, runs).
            held: newest sample from slot k - j or before, as the wire brings it, 0 without one, (memory + 1, p, runs).
        """
        have, last, memory = self._have, self._last, self._memory
        have[1:] = have[:-1].copy()
        have[0] = False
        run, node, sent = self._arrivals[k]
        np.maximum.at(last, (node, run), sent)
        for i in range(int(self._buffers.max())):
            age = k - sent + i
            there = (i < self._buffers[node]) & (sent >= i) & (age <= memory)
            have[age[there], node[there], run[there]] = True
        ago = k - last
        source = np.where((last >= 0) & (ago > memory), ago, -1)
        held = np.zeros((memory + 1, len(self._node_of), self._runs))
        for j in range(memory, -1, -1):
            source = np.where(have[j], j, source)
            for output, own in enumerate(self._node_of):
                at = (k - source[own]) * self._runs + self._columns
                value = outputs[output].reshape(-1).take(at, mode="clip").astype(np.float32)
                held[j, output] = np.where(source[own] >= 0, value, 0.0)
        return have, held


def nodes_of(loop: Loop) -> list[int]:
    """Return the node that measures each output."""
    return [node for _, node in sorted((output, i) for i, s in enumerate(loop.rig.sensors) for output in s.outputs)]
