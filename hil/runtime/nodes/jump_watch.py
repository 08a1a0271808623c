"""Compares a plant that jumps with the matrices of its modes, and a network law with its chain, while they run.

Of a plant, the slots are compared that begin and end in the same mode. A jump to another mode and back within a slot is not seen,
so a few slots may miss the matrices, as many as the rates allow. Where noise moves the plant, a second run of the same seed
without commands has the same modes and noise, and the difference of both runs is compared: first `STRIDE` slots at once, and slot
by slot where these miss. In the run a block is compared in small steps, one in each slot. Of a law, the modes that it drew are
compared once the run has ended.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from math import log
from typing import Final, NamedTuple, cast

import numpy as np

from hil.rig.loop import CANCELS, EQUAL, LARGEST, Array, JumpStep
from hil.runtime.nodes.plant_watch import ANOTHER, MOST_KEPT, Blocks, Result, at_once
from plants.parts.protocols import PlantRun
from transport.draws import ABSENT, DELIVERED, DISORDERED, NONE_YET, REPEATED, Draw
from transport.law_tests import law_p_value
from transport.laws import ChainLaw, InitialLaw, NetworkLaw, SemiMarkovLaw

InSteps = Generator[None, None, Result]
"""Work in steps, of a slot each."""
UNLIKELY: Final = 1e-9
"""Probability below which a count of missed slots, by Chernoff's bound, or the record of a law contradicts what is stated.

One run in 1e9 of a plant or law that is as stated loses its certificate.
"""
SUSPECT: Final = 1e-3
"""The same probability for slots that are compared many at once: below it, every slot is compared."""
OF_A_LAW: Final = {ABSENT, DELIVERED, DISORDERED, NONE_YET, REPEATED}
"""What is decided in a slot for whose packet the law was asked."""
FEW: Final = 3
"""Slots that may miss in any run, whatever the rates."""
STRIDE: Final = 32
"""Slots by which a long second run advances at once: that takes a plant little longer than one slot."""


class Missed(NamedTuple):
    """Numbers of compared and of missed steps; the slot in which the missed are too many, and a phrase that says by how much."""

    compared: int
    steps: int
    left: tuple[int, str] | None


class JumpWatch:
    """Compares a plant's record with the flows of its modes.

    Args:
        step: the bound of its record.
        start: starts the plant again as in this run.
        period_ns: sample period, ns.
    """

    def __init__(self, step: JumpStep, start: Callable[[], PlantRun], period_ns: int) -> None:
        self._step, self._start, self._period_ns = step, start, period_ns
        self._n = step.flows.shape[1]
        self._m = step.flows.shape[2] - self._n
        # Outputs, of which the last is the mode, command and disturbance.
        self._blocks = Blocks(self._n + 1 + 2 * self._m, 1, self._compare)
        self._compared = self._missed = 0
        self._first = -1  # slot of the first of what was kept
        self._kept: list[Array] = []

    def take(self, x: Sequence[float], y: Sequence[float], u: Sequence[float], w: Sequence[float]) -> None:
        """Take states, outputs, command and disturbance of a slot."""
        blocks = self._blocks
        blocks.pack(blocks.seen, blocks.filled, *y, *u, *w)
        blocks.taken()

    def _compare(self, begin: int, z: Array) -> Iterator[None]:
        """Compare a block; see `Blocks`."""
        if begin + len(z) > MOST_KEPT and self._kept:
            return
        if not self._suspected():  # else a second run decides
            yield
            columns = np.ascontiguousarray(z.T)
            found = yield from self._missed_in(columns[: self._n], columns, begin, 1, 0.0)
            self._compared, self._missed = self._compared + found.compared, self._missed + found.steps
            if not self._kept and not found.steps:
                return
        self._first = self._first if self._kept else begin
        self._kept.append(z[1:] if self._kept else z)

    def _suspected(self) -> bool:
        return _too_many(self._missed, self._step.unseen * self._compared)

    def _missed_in(self, x: Array, z: Array, begin: int, stride: int, lost: float) -> InSteps[Missed]:
        """Compare the motion x, (n, steps + 1), with the flows of the modes.

        Args:
            x: states every `stride` slots.
            z: the record, one column a slot.
            begin: slot of its first column.
            stride: slots of a step.
            lost: rounding error of x.
        """
        step, n, m, count = self._step, self._n, self._m, x.shape[1] - 1
        if count < 1:
            return Missed(0, 0, None)
        modes = np.where((np.abs(z) < LARGEST).all(axis=0), z[n], -1.0).astype(np.int64)
        yield
        v = z[n + 1 : n + 1 + m] + z[n + 1 + m :]
        starts = modes[: stride * count : stride]
        stays = starts >= 0
        yield
        for i in range(1, stride + 1):
            stays &= modes[i : i + stride * (count - 1) + 1 : stride] == starts
        at = np.flatnonzero(stays)
        mode = np.clip(starts[at] - 1, 0, len(step.flows) - 1)
        share, apart = np.full((n, len(at)), np.inf), np.zeros((n, len(at)))
        for i, (flow, band) in enumerate(zip(step.flows, step.bands)):
            own = np.flatnonzero(mode == i if step.seen else ~(share.max(axis=0) <= EQUAL))
            yield
            k = at[own]
            known = np.concatenate([x[:, k], v[:, stride * k]])
            for slot in range(1, stride):
                yield
                known = np.concatenate([_after(flow, known), v[:, stride * k + slot]])
            of, by = yield from _beyond(flow, band, known, x[:, k + 1], lost)
            yield
            nearer = of.max(axis=0) < share[:, own].max(axis=0)
            share[:, own[nearer]], apart[:, own[nearer]] = of[:, nearer], by[:, nearer]
        yield
        far = np.flatnonzero(~(share.max(axis=0) <= EQUAL))
        unseen = step.unseen * (stride**2 if step.seen else stride)
        for number, at_far in enumerate(far.tolist(), start=1):
            if _too_many(number, unseen * at_far, UNLIKELY if stride == 1 else SUSPECT):
                i = int(share[:, at_far].argmax())
                text = "{:.2g} {} ({})".format(apart[i, at_far], *reversed(step.names[i])).replace(" 1 (", " (")
                return Missed(len(at), len(far), (begin + stride * int(at[at_far] + 1), text))
        return Missed(len(at), len(far), None)

    def departed(self) -> tuple[int, str] | None:
        """Return the slot in which the plant left its modes, and by how much, once the run has ended; None if it did not."""
        self._blocks.finish()
        if not self._kept or not self._suspected():
            return self._blocks.broken
        own, left = np.concatenate(self._kept), None
        many = len(own) > ANOTHER and not self._step.bands.any()  # what is uncertain is bounded for one slot only
        for stride in (STRIDE, 1) if many else (1,):
            left = self._beside(own, stride)
            if left is None:
                return self._blocks.broken
        return left

    def _beside(self, own: Array, stride: int) -> tuple[int, str] | None:
        """Return where the difference to a run without commands leaves the modes, compared every `stride` slots."""
        n, alone = self._n, self._alone((len(own) - 1) // stride + 1, stride)
        same = own[: stride * len(alone) : stride]
        other = np.flatnonzero(same[:, n] != alone[:, n])
        if len(other):
            return self._first + stride * int(other[0]), "a mode that its inputs change"
        lost = CANCELS * float(np.abs(same[:, :n]).max(initial=0.0) + np.abs(alone[:, :n]).max(initial=0.0))
        difference = np.ascontiguousarray((same[:, :n] - alone[:, :n]).T)
        return at_once(self._missed_in(difference, np.ascontiguousarray(own.T), self._first, stride, lost)).left

    def _alone(self, count: int, stride: int) -> Array:
        """Return the outputs of a run without commands, every `stride` slots from the first that was kept, as far as it runs."""
        run, rows, still, slot = self._start(), [], (0.0,) * self._m, 0
        for k in range(self._first, self._first + stride * count, stride):
            try:
                while slot < k:
                    slots = min(stride, k - slot)
                    run.advance(slots * self._period_ns, still, still)
                    slot += slots
                y = run.measure()
            except Exception:  # whatever an author's plant does without commands: until there it is compared
                break
            if not abs(sum(y)) < LARGEST:
                break
            rows.append(y)
        return np.array(rows, dtype=float).reshape(len(rows), self._n + 1)


def _after(flow: Array, known: Array) -> Array:
    """States a slot later, (n, slots)."""
    return np.array([sum((a * column for a, column in zip(row, known)), np.zeros(known.shape[1])) for row in flow.tolist()])


def _beyond(flow: Array, band: Array, known: Array, after: Array, lost: float) -> InSteps[tuple[Array, Array]]:
    """By how much the states after a slot leave their band, (n, slots): as a share of the largest sum of terms, and absolute."""
    left, scale, allowed = after.copy(), np.abs(after), np.full_like(after, lost)
    for i, column in zip(*np.nonzero(flow)):  # in one order on every machine
        yield
        term = flow[i, column] * known[column]
        left[i] -= term
        scale[i] += np.abs(term)
    for i, column in zip(*np.nonzero(band)):
        yield
        allowed[i] += band[i, column] * np.abs(known[column])
    yield
    apart = np.maximum(np.abs(left) - allowed, 0.0)
    return apart / (scale.max(axis=0) + 1e-300), apart


def _too_many(count: int, mean: float, chance: float = UNLIKELY) -> bool:
    """Whether a count of jumps is too large for its mean: its probability is below `chance` by Chernoff's bound."""
    return count > max(FEW, mean) and count * log(count / max(mean, 1e-300)) - count + mean > -log(chance)


class LawWatch:
    """Keeps the modes that a law draws.

    Args:
        law: a `ChainLaw` or a `SemiMarkovLaw`.
    """

    def __init__(self, law: NetworkLaw) -> None:
        self._law, self._ages = law, [int(age) for age in cast(ChainLaw | SemiMarkovLaw, law).mode_ages]
        self.name = type(law).__qualname__
        self._modes: list[int] = []
        self._other: tuple[int, str] | None = None

    def take(self, draws: Sequence[Draw]) -> None:
        """Take what was decided in a slot."""
        if self._other is None and not any(draw.mode >= 0 for draw in draws) and any(draw.reason in OF_A_LAW for draw in draws):
            self._other = len(self._modes), "a mode below 0"
        for draw in draws:
            mode = draw.mode
            if mode >= 0:
                self._modes.append(mode)
                if self._other is None and (mode >= len(self._ages) or draw.age != self._ages[mode]):
                    self._other = len(self._modes) - 1, f"an age of {draw.age} slots in mode {mode}"

    def departed(self) -> tuple[int, str] | None:
        """Return the slot in which the law left its chain, and by what; None if it did not, as far as its record can tell."""
        if self._other is not None or not self._modes:
            return self._other
        law, modes = self._law, np.array(self._modes, dtype=np.int64)
        if isinstance(law, InitialLaw) and law.initial != "stationary" and not law.initial_law()[modes[0]] > 0.0:
            return 0, f"mode {modes[0]}, in which it never begins"
        if not law_p_value(law, modes) < UNLIKELY:
            return None
        first, last = 1, len(modes)  # the first record that is as unlikely, up to a sixteenth of the run
        step = max(last // 16, 1)
        while first < last and not law_p_value(law, modes[:first]) < UNLIKELY:
            first += step
        p_value = law_p_value(law, modes[: min(first, last)])
        return min(first, last) - 1, f"modes that its chain draws with probability {p_value:.2g}"
