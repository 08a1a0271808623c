"""Whether a controller answers as its table says: its rows beside those of the same gains in the loop's own arithmetic.

Two runs on the same delays and references, one on random samples and one on zeros, differ by K Y alone; so an own feedforward is
left alone, and every row, age and sample is compared at samples of every size.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from design.controllers import Known, LoopModel, MultiSampleController, Rows, Sample, SensorNodes
from hil.rig.watched import EQUAL, Running

Array = NDArray[np.float64]
Start = Callable[[], Running]

SLOTS = 120
SEED = 20240302
FAR = (200, 300, 1000, 3000, 10_000)
"""Slots at the end that a table is asked in too: a table knows no slot."""


class Question(Struct, frozen=True, kw_only=True):
    """What a controller is asked in one run.

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


class Answer(Struct, frozen=True, kw_only=True):
    """How far answers are from a table's: share of them, slot, age, row and input, and both values."""

    size: float
    share: float = 0.0
    slot: int = 0
    age: int = 0
    row: int = 0
    found: float = 0.0
    foretold: float = 0.0


def question(
    model: LoopModel, *, width: int, slots: int = SLOTS, longest: int = 1, far: bool = False, aims: float = 1.0
) -> Question:
    """Return random samples with ages that change and last: every age comes, and lasts longer than any gain distinguishes.

    Args:
        model: the loop.
        width: values in a packet.
        slots: how many.
        longest: length of stay from which on no gain changes.
        far: whether slots of a long run follow.
        aims: every entry of the reference.
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
    return Question(
        slots=numbers, ages=ages, samples=rng.uniform(-1.0, 1.0, (slots, width)), reference=(aims,) * model.C.shape[0],
    )  # fmt: skip


def over_nodes(model: LoopModel, *, memory: int) -> Question:
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
    return Question(
        slots=tuple(range(SLOTS)), ages=np.zeros((SLOTS, 1), dtype=np.int64), samples=rng.uniform(-1.0, 1.0, (SLOTS, p)),
        reference=(0.0,) * p, received=tuple(received),
    )  # fmt: skip


def answers(running: Running, asked: Question, size: float, nodes: SensorNodes) -> Array:
    """Return the rows of a controller in every slot, (slots, rows, m); it ends where they are not numbers."""
    return np.array(list(_answered(running, asked, size, nodes)), dtype=float)


def _answered(running: Running, asked: Question, size: float, nodes: SensorNodes) -> Iterator[Rows]:
    if isinstance(running, MultiSampleController):
        for i, k in enumerate(asked.slots):
            yield running.rows(k, Known(_known(asked, i, k, size, nodes), asked.reference))
        return
    scale = np.full(asked.samples.shape[1], size)
    scale[-1] = 1.0 if asked.modes else size
    packets, ages = (scale * asked.samples).tolist(), asked.ages.max(axis=1).tolist()
    for k, age, y in zip(asked.slots, ages, packets):
        yield running.rows(k, age, tuple(y), asked.reference)


def _known(asked: Question, i: int, k: int, size: float, nodes: SensorNodes) -> tuple[Sample, ...]:
    """What is known in a slot, newest first."""
    if asked.received:
        return tuple(
            Sample(node, slot, tuple(float(size * asked.samples[slot, o]) for o in nodes.outputs[node]))
            for node, slot in asked.received[i]
        )
    values, known = size * asked.samples[i], []
    for node, own in enumerate(nodes.outputs):
        known.append(Sample(node, k - int(asked.ages[i, node]), tuple(float(values[o]) for o in own)))
    return tuple(sorted(known, key=lambda sample: (-sample.slot, sample.node)))


def compared(
    own: Start, stated: Start, at_rest: tuple[Array, Array], asked: Question, nodes: SensorNodes, sizes: Sequence[float]
) -> list[Answer]:
    """Return for every size of the samples how far the answers to them are from those of what is stated.

    Args:
        own: starts the controller.
        stated: starts what it says that it is.
        at_rest: answers of both to samples of zero.
        asked: what both are asked.
        nodes: the sensor nodes.
        sizes: of the samples, increasing.
    """
    rest, still = at_rest
    found = []
    for size in sizes:
        moved, expected = answers(own(), asked, size, nodes) - rest, answers(stated(), asked, size, nodes) - still
        if moved.shape != expected.shape:
            found.append(Answer(size=size, share=np.inf))
            continue
        scale = np.maximum.accumulate(np.abs(expected).max(axis=(1, 2), keepdims=True)) + 1e-9 * np.abs(expected).max() + 1e-300
        lost = 1e-12 * (np.abs(rest).max(axis=(1, 2), keepdims=True) + np.abs(still).max(axis=(1, 2), keepdims=True))
        apart = np.nan_to_num(np.abs(moved - expected) - lost, nan=np.inf) / scale
        if not (apart > EQUAL).any():
            found.append(Answer(size=size, share=max(float(apart.max()), 0.0)))
            continue
        at = int((apart > EQUAL).any(axis=(1, 2)).argmax())
        row, j = np.unravel_index(int(apart[at].argmax()), apart[at].shape)
        found.append(
            Answer(
                size=size, share=float(apart.max()), slot=asked.slots[at], age=int(asked.ages[at].max()), row=int(row),
                found=float(moved[at, row, j]), foretold=float(expected[at, row, j]),
            )
        )  # fmt: skip
    return found


def outgrows(at_rest: tuple[Array, Array], asked: Question) -> tuple[int, float, float] | None:
    """Return the last slot, and what a controller adds of its own there and in the first slots, where that grows with time.

    Asked of the slots `FAR` alone: each time more than in the one before, and in the end 3 times as much as in the first slots.
    """
    if asked.slots[-len(FAR) :] != FAR:
        return None
    rest, still = at_rest
    if rest.shape != still.shape or len(rest) < len(asked.slots):
        return None
    added = np.abs(rest - still).max(axis=(1, 2))
    early, late = float(added[: -len(FAR)].max()), added[-len(FAR) :]
    grows = bool((late[1:] > 1.1 * late[:-1]).all()) and late[-1] > 3.0 * early + 1e-9 * float(np.abs(still).max())
    return (asked.slots[-1], float(late[-1]), early) if grows else None


def share_memory(own: Start, alone: Array, asked: Question, nodes: SensorNodes) -> bool:
    """Return whether a controller on samples of zero answers otherwise than alone while another is asked beside it."""
    beside = zip(_answered(own(), asked, 1.0, nodes), _answered(own(), asked, 0.0, nodes))
    return not np.array_equal(alone, np.array([rows for _, rows in beside], dtype=float))


def drifts(own: Start, asked: Question, nodes: SensorNodes) -> float:
    """Return how far the answers change while every sample and reference is zero; inf where two runs differ."""
    first, again = (answers(own(), asked, 0.0, nodes) for _ in range(2))
    if first.shape != again.shape or not np.array_equal(first, again):
        return np.inf
    apart = float(np.abs(first - first[0]).max())
    return apart if apart > 1e-9 * max(1.0, float(np.abs(first[0]).max())) else 0.0
