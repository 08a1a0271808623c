"""The test of a controller before a run: its rows are compared with those of the gains that it states.

Two runs with the same delays and references, one on random samples and one on samples of zero, differ by K Y alone, whatever the
controller's feedforward is. This difference is compared for every row and age, at samples of several sizes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from design.controllers import Known, LoopModel, MultiSampleController, Rows, Sample, SensorNodes
from hil.certify.motion_test import so_far
from hil.rig.loop import EQUAL, Array, Running

Start = Callable[[], Running]

SLOTS = 120
SEED = 20240302
FAR = (200, 300, 1000, 3000, 10_000)
"""Slots late in a run in which a table is evaluated, too: its rows may not depend on the slot."""


class Excitation(Struct, frozen=True, kw_only=True):
    """The inputs of a controller in one run of the test.

    Args:
        slots: numbers of the slots, increasing.
        ages: age of the newest sample in each, (slots,); of every node, (slots, nodes).
        samples: the packet's values in every slot, of size 1, (slots, width).
        reference: one entry per output.
        received: of a controller over scheduled nodes: what it knows in every slot, as (node, slot) pairs, newest first; the
            values are those of `samples` in that slot. Empty: the newest sample of every node, of its age.
    """

    slots: tuple[int, ...]
    ages: NDArray[np.int64]
    samples: Array
    reference: tuple[float, ...]
    received: tuple[tuple[tuple[int, int], ...], ...] = ()
    modes: bool = False
    """Whether the last value of a sample is a mode, which has no size."""


class Mismatch(Struct, frozen=True, kw_only=True):
    """The largest difference of answers to those of a table: as a share, its slot, age, row and input, and both values."""

    size: float
    share: float = 0.0
    slot: int = 0
    age: int = 0
    row: int = 0
    found: float = 0.0
    foretold: float = 0.0


def random_excitation(
    model: LoopModel, *, width: int, slots: int = SLOTS, longest: int = 1, far: bool = False, reference: float = 1.0
) -> Excitation:
    """Return random samples with ages that change and last: every age comes, and lasts longer than any gain distinguishes.

    Args:
        model: the loop.
        width: values in a packet.
        slots: how many.
        longest: length of stay from which on no gain changes.
        far: whether slots of a long run follow.
        reference: every entry of the reference.
    """
    rng = np.random.default_rng(SEED)
    nodes, most = len(model.nodes.names), model.tau_max
    ages = np.zeros((slots, nodes), dtype=np.int64)
    for column in ages.T:
        k, age = 0, 0
        while k < slots:
            held = int(rng.integers(1, longest + 3))
            column[k : k + held] = age % (most + 1)
            k, age = k + held, age + int(rng.integers(1, most + 2))
    numbers = tuple(range(most, most + slots))  # a sample is never older than the run
    if far and numbers[-1] < FAR[0]:
        numbers = (*numbers[: -len(FAR)], *FAR)
    return Excitation(
        slots=numbers, ages=ages, samples=rng.uniform(-1.0, 1.0, (slots, width)), reference=(reference,) * model.C.shape[0],
    )  # fmt: skip


def scheduled_excitation(model: LoopModel, *, memory: int) -> Excitation:
    """Return what scheduled nodes send: turns and losses as the medium states them, held as long as gains look back.

    Args:
        model: the loop, with its sensor nodes.
        memory: age of the oldest sample that is used.
    """
    rng, nodes, turns = np.random.default_rng(SEED), model.nodes, model.nodes.turns
    turn, lost_in = rng.integers(len(nodes.names), size=SLOTS).tolist(), (rng.integers(5, size=SLOTS) == 0).tolist()
    kept: list[set[int]] = [set() for _ in nodes.names]
    received = []
    for k in range(SLOTS):
        for node, delay in enumerate(nodes.delays):
            sent = k - (delay or 0)
            if turns is None:
                ages = [0]
            elif turns.cycle:
                ages = [age for n, age in turns.cycle[(sent + turns.phase) % turns.phases] if n == node]
            else:
                ages = [0] if turn[sent] == node else []
            lost = turns is not None and turns.loss > 0.0 and lost_in[sent]
            for age in ages if sent >= 0 and not lost else ():
                kept[node] |= {s for s in range(sent - age, sent - age - nodes.buffers[node], -1) if s >= 0}
        for own in kept:
            own -= {s for s in own if s < k - memory and s != max(own)}
        received.append(tuple(sorted(((n, s) for n, own in enumerate(kept) for s in own), key=lambda pair: (-pair[1], pair[0]))))
    p = model.C.shape[0]
    return Excitation(
        slots=tuple(range(SLOTS)), ages=np.zeros((SLOTS, 1), dtype=np.int64), samples=rng.uniform(-1.0, 1.0, (SLOTS, p)),
        reference=(0.0,) * p, received=tuple(received),
    )  # fmt: skip


def answers(running: Running, excitation: Excitation, size: float, nodes: SensorNodes) -> Array:
    """Return the rows of a controller in every slot, (slots, rows, m); it ends where they are not numbers."""
    return np.array(list(_rows_of(running, excitation, size, nodes)), dtype=float)


def _rows_of(running: Running, excitation: Excitation, size: float, nodes: SensorNodes) -> Iterator[Rows]:
    if isinstance(running, MultiSampleController):
        for i, k in enumerate(excitation.slots):
            yield running.rows(k, Known(_known(excitation, i, k, size, nodes), excitation.reference))
        return
    scale = np.full(excitation.samples.shape[1], size)
    scale[-1] = 1.0 if excitation.modes else size
    packets, ages = (scale * excitation.samples).tolist(), excitation.ages.max(axis=1).tolist()
    for k, age, y in zip(excitation.slots, ages, packets):
        yield running.rows(k, age, tuple(y), excitation.reference)


def _known(excitation: Excitation, i: int, k: int, size: float, nodes: SensorNodes) -> tuple[Sample, ...]:
    """What is known in a slot, newest first."""
    if excitation.received:
        return tuple(
            Sample(node, slot, tuple(float(size * excitation.samples[slot, o]) for o in nodes.outputs[node]))
            for node, slot in excitation.received[i]
        )
    values, known = size * excitation.samples[i], []
    for node, own in enumerate(nodes.outputs):
        known.append(Sample(node, k - int(excitation.ages[i, node]), tuple(float(values[o]) for o in own)))
    return tuple(sorted(known, key=lambda sample: (-sample.slot, sample.node)))


def mismatches(
    own: Start, stated: Start, at_zero: tuple[Array, Array], excitation: Excitation, nodes: SensorNodes, sizes: Sequence[float]
) -> list[Mismatch]:
    """Return the largest difference of the answers to those of the stated controller, for every size of the samples.

    Args:
        own: starts the controller.
        stated: starts what it says that it is; where that is the controller itself, it answers once for both.
        at_zero: rows of both for samples of zero.
        excitation: the inputs of both.
        nodes: the sensor nodes.
        sizes: of the samples, increasing.
    """
    own_at_zero, stated_at_zero = at_zero
    found = []
    for size in sizes:
        answered = answers(own(), excitation, size, nodes)
        moved = answered - own_at_zero
        expected = (answered if stated is own else answers(stated(), excitation, size, nodes)) - stated_at_zero
        if moved.shape != expected.shape:
            found.append(Mismatch(size=size, share=np.inf))
            continue
        scale = np.maximum.accumulate(np.abs(expected).max(axis=(1, 2), keepdims=True)) + 1e-9 * so_far(expected)
        lost = 1e-12 * sum(np.abs(rows).max(axis=(1, 2), keepdims=True) for rows in at_zero)
        apart = np.nan_to_num(np.abs(moved - expected) - lost, nan=np.inf) / scale
        if not (apart > EQUAL).any():
            found.append(Mismatch(size=size, share=max(float(apart.max()), 0.0)))
            continue
        at = int((apart > EQUAL).any(axis=(1, 2)).argmax())
        row, j = np.unravel_index(int(apart[at].argmax()), apart[at].shape)
        found.append(
            Mismatch(
                size=size, share=float(apart.max()), slot=excitation.slots[at], age=int(excitation.ages[at].max()), row=int(row),
                found=float(moved[at, row, j]), foretold=float(expected[at, row, j]),
            )
        )  # fmt: skip
    return found


def growing_feedforward(at_zero: tuple[Array, Array], excitation: Excitation) -> tuple[int, float, float] | None:
    """Return the last slot, the feedforward there, and that of the first slots, if it grows with time; else None.

    It grows if it rises from each of the slots `FAR` to the next, and is at last 3 times as large as in the first slots.
    """
    if excitation.slots[-len(FAR) :] != FAR:
        return None
    own_at_zero, stated_at_zero = at_zero
    if own_at_zero.shape != stated_at_zero.shape or len(own_at_zero) < len(excitation.slots):
        return None
    added = np.abs(own_at_zero - stated_at_zero).max(axis=(1, 2))
    early, late = float(added[: -len(FAR)].max()), added[-len(FAR) :]
    grows = bool((late[1:] > 1.1 * late[:-1]).all()) and late[-1] > 3.0 * early + 1e-9 * float(np.abs(stated_at_zero).max())
    return (excitation.slots[-1], float(late[-1]), early) if grows else None


def shares_memory(own: Start, alone: Array, excitation: Excitation, nodes: SensorNodes) -> bool:
    """Return whether a controller's rows for samples of zero change while a second instance runs beside it."""
    beside = zip(_rows_of(own(), excitation, 1.0, nodes), _rows_of(own(), excitation, 0.0, nodes))
    return not np.array_equal(alone, np.array([rows for _, rows in beside], dtype=float))


def drift_at_zero(own: Start, excitation: Excitation, nodes: SensorNodes, runs: int = 2) -> float:
    """Return how far the answers change while every sample and reference is zero; inf where two runs differ."""
    first, *others = (answers(own(), excitation, 0.0, nodes) for _ in range(runs))
    if not all(np.array_equal(first, again) for again in others):
        return np.inf
    apart = float(np.abs(first - first[0]).max())
    return apart if apart > 1e-9 * max(1.0, float(np.abs(first[0]).max())) else 0.0
