"""Compares the record of a running plant with its model, by the one-step equation error, a block of slots at a time.

A block is compared in small steps, one in each of the slots that follow: at once, 1024 slots took 250 us where caches are cold,
and a session in real time would be late.

The equation error is compared with that of a second run of the same seed without commands: noise and loads are the same in both
runs, so a difference shows an error that depends on the motion.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from operator import add
from struct import Struct
from typing import Final, TypeVar

import numpy as np

from hil.rig.loop import CANCELS, EQUAL, LARGEST, RUN_AGAIN, Array, OneStep, kind_of
from plants.parts.protocols import PlantRun

BLOCK: Final = 512
"""Slots that are compared at once."""
MOST_KEPT: Final = 200_000
"""Slots with loads or noise whose equation error is kept: it may not grow in these, and later slots are not compared."""
ANOTHER: Final = 2048
"""Slots of a run with other random numbers, by which the kind of the equation error is found; see `kind_of`."""


class Blocks:
    """Collects the signals of the slots, and has each block of them compared in small steps, one in each slot that follows.

    Args:
        width: numbers of a slot.
        history: slots before a block that are compared with it.
        compare: given the slot of the first row, and the rows of the slots before the block and of its own, (slots, width).

    Attributes:
        pack, seen, filled: `pack` writes the signals of a slot into the bytes `seen`, at the offset `filled`.
        broken: the first slot with a signal that is not finite, unless they grew until then; and in words that it is.
    """

    def __init__(self, width: int, history: int, compare: Callable[[int, Array], Iterator[None]]) -> None:
        slot = Struct(f"{width}d")
        self.pack, self._bytes, self.filled = slot.pack_into, slot.size, 0
        self.seen = bytearray(BLOCK * slot.size)  # numbers: Python objects would leave the cache cold
        self._past, self._history, self._next = np.zeros((0, width)), history, 0
        self._compare = compare
        self._work: Iterator[None] | None = None
        self.broken: tuple[int, str] | None = None

    def taken(self) -> None:
        """Go on to the next slot; the signals of this one are packed."""
        self.filled += self._bytes
        if self._work is not None:
            self._go_on()
        if self.filled == len(self.seen):
            self._begin()

    def finish(self) -> None:
        """Compare all slots that are left, without steps."""
        if self.filled:
            self._begin()
        self._catch_up()

    def _begin(self) -> None:
        """Finish the block before, and take the first step of a copy of the new one."""
        self._catch_up()
        now = np.frombuffer(self.seen)[: self.filled // 8].reshape(-1, self._past.shape[1])
        z, begin = np.concatenate([self._past, now]), self._next - len(self._past)
        self._next, self.filled = self._next + len(now), 0
        if self.broken is None and not np.isfinite(now).all():
            k = int(np.isfinite(z).all(axis=1).argmin())
            if (np.abs(z[max(k - 1, 0) : k]) < LARGEST).all():  # no motion overflows in one slot
                self.broken = begin + k, "a value that is not finite"
        self._past = z[-self._history :] if self._history else z[:0]
        self._work = self._compare(begin, z)
        self._go_on()

    def _go_on(self) -> None:
        if self._work is not None and next(self._work, True):  # a step returns None
            self._work = None

    def _catch_up(self) -> None:
        while self._work is not None:
            self._go_on()


class PlantWatch:
    """Compares a plant's record with its model.

    Args:
        step: the equation of its record.
        start: starts the plant again, with the random numbers of this run (0) or with others (1).
        disturbance: disturbance of a slot, added to the commands.
        period_ns: sample period, ns.
    """

    def __init__(
        self, step: OneStep, start: Callable[[int], PlantRun], disturbance: Callable[[int], Sequence[float]], period_ns: int
    ) -> None:
        self._step, self._start, self._disturbance, self._period_ns = step, start, disturbance, period_ns
        self._blocks = Blocks(step.taps.shape[2], len(step.taps) - 1, self._compare)
        self._scale = np.zeros(step.taps.shape[1])
        self._first = -1  # slot of the first of what was kept
        self._kept: list[tuple[Array, Array]] = []
        self._count = 0

    def take(self, x: Sequence[float], y: Sequence[float], u: Sequence[float], w: Sequence[float]) -> None:
        """Take states, outputs, command and disturbance of a slot."""
        blocks = self._blocks
        blocks.pack(blocks.seen, blocks.filled, *x, *y, *map(add, u, w))
        blocks.taken()

    def _compare(self, begin: int, z: Array) -> Iterator[None]:
        """Compare a block; see `Blocks`."""
        history = len(self._step.taps) - 1
        if len(z) <= history or self._count >= MOST_KEPT:
            return
        yield
        sums = _zeros(self._step.taps, z)
        yield
        yield from _add_terms(self._step.taps, z, *sums)
        left, largest = sums[0].T, np.maximum.accumulate(sums[1].T)
        yield
        scale = np.maximum(largest, self._scale)
        self._scale = scale[-1]
        yield
        with np.errstate(over="ignore", invalid="ignore"):
            quiet = (np.abs(left) <= EQUAL * scale).all()
        if self._kept or not quiet:
            if not self._kept:
                self._first = begin + history
            self._kept.append((left, scale))
            self._count += len(left)

    def departed(self) -> tuple[int, str] | None:
        """Return the slot in which the plant left its model, and by how much, once the run has ended; None if it did not."""
        self._blocks.finish()
        if not self._kept:
            return self._blocks.broken
        with np.errstate(over="ignore", invalid="ignore"):
            return self._judged(*(np.concatenate(parts) for parts in zip(*self._kept))) or self._blocks.broken

    def _judged(self, left: Array, scale: Array) -> tuple[int, str] | None:
        again = min(len(left), RUN_AGAIN)
        free, of_free = self._alone(0, again)
        same, lost = left[: len(free)], CANCELS * np.maximum.accumulate(of_free)
        beyond = ~(np.abs(same - free) - lost <= EQUAL * scale[: len(free)])
        if beyond.any():
            k = int(beyond.any(axis=1).argmax())
            i = int(beyond[k].argmax())
            name, unit = self._step.names[i]
            return self._first + k, f"{_rounded(abs(same[k, i] - free[k, i]))} {unit} ({name})".replace(" 1 (", " (")
        if self._step.stated or len(free) < again:
            return None
        first = min(again, ANOTHER)
        other, _ = self._alone(1, first)
        own = kind_of(left[:first], other, scale[:first], list(self._step.names))
        if own.kind == "noise" and len(left) > first:  # slots that were not run again are judged by growth alone
            own = kind_of(left, other, scale, list(self._step.names))
        if own.kind != "moves":
            return None
        k = int((np.abs(left) > EQUAL * scale).any(axis=1).argmax())
        return self._first + k, f"up to {_rounded(own.size)} {own.signal[1]} in a slot, without inputs ({own.signal[0]})"

    def _alone(self, which: int, slots: int) -> tuple[Array, Array]:
        """Return the equation error of a run without commands in the slots that were kept, and the sizes of its terms."""
        run, history, end = self._start(which), len(self._step.taps) - 1, self._first + slots
        w = self._disturbance(0)
        still, rows = (0.0,) * len(w), []
        begin = self._first - history
        for k in range(end):
            try:
                if k:
                    run.advance(self._period_ns, still, w)
                y, x, w = run.measure(), run.state, self._disturbance(k)
            except Exception:  # whatever an author's plant does without commands: until there it is compared
                break
            if not abs(sum(x)) + abs(sum(y)) < LARGEST:
                break
            if k >= begin:
                rows.append((*x, *y, *w))
        z = np.array(rows, dtype=float).reshape(len(rows), self._step.taps.shape[2])
        if len(z) <= history:
            return np.zeros((0, len(self._scale))), np.zeros((0, len(self._scale)))
        return left_over(self._step.taps, z)


def left_over(taps: Array, z: Array) -> tuple[Array, Array]:
    """Return e(k) = sum_i taps[i] z(k - i) and the sum of the absolute values, (slots - h, q); in one order on every machine."""
    left, scale = _zeros(taps, z)
    for _ in _add_terms(taps, z, left, scale):
        pass
    return left.T, scale.T


def _zeros(taps: Array, z: Array) -> tuple[Array, Array]:
    shape = taps.shape[1], len(z) - len(taps) + 1
    return np.zeros(shape), np.zeros(shape)


def _add_terms(taps: Array, z: Array, left: Array, scale: Array) -> Iterator[None]:
    """Add the terms of both sums to (q, slots - h), one in each step."""
    history, columns = len(taps) - 1, np.ascontiguousarray(z.T)
    for i, j, column in zip(*np.nonzero(taps)):
        yield
        with np.errstate(over="ignore", invalid="ignore"):
            term = taps[i, j, column] * columns[column, history - i : history - i + left.shape[1]]
            left[j] += term
            scale[j] += np.abs(term)


def _rounded(value: float) -> str:
    return f"{value:.2g}"


Result = TypeVar("Result")


def at_once(work: Generator[None, None, Result]) -> Result:
    """Take all steps of a piece of work, and return what it returns."""
    while True:
        try:
            next(work)
        except StopIteration as end:
            result: Result = end.value
            return result
