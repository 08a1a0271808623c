"""Whether a plant that jumps keeps to the matrices of its modes in the run: slots whose two ends show the same mode.

A jump that comes and goes within a slot is not seen, so that a few slots may miss: no more than the rates let be. Where noise
moves the plant, a second run of the same seed without commands has the same modes and noise, and the difference is compared.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Sequence
from math import log
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil.certify.jump_loop import JumpStep
from hil.certify.motion_test import CANCELS, EQUAL, LARGEST
from hil.runtime.nodes.plant_watch import BLOCK, MOST_KEPT
from plants.parts.protocols import PlantRun

Array = NDArray[np.float64]
UNLIKELY: Final = 1e-9
"""Chance of so many jumps that nobody saw, by Chernoff's bound."""
FEW: Final = 3
"""Slots that may miss in any run."""


class Missed(NamedTuple):
    """How many slots were compared and how many miss; the slot in which they are too many, and by how much it misses."""

    compared: int
    slots: int
    left: tuple[int, str] | None


class JumpWatch:
    """Compares a plant's record with the flows of its modes.

    Args:
        step: what the record fulfils.
        start: starts the plant again as in this run.
        disturbance: what is added to the commands in a slot.
        period_ns: sample period, ns.
    """

    def __init__(
        self, step: JumpStep, start: Callable[[], PlantRun], disturbance: Callable[[int], Sequence[float]], period_ns: int
    ) -> None:
        self._step, self._start, self._disturbance, self._period_ns = step, start, disturbance, period_ns
        self._slots = array("d")  # outputs, command and disturbance of each, one behind the other
        self._width = 0
        self._past: Array | None = None
        self._next = self._compared = self._missed = 0
        self._first = -1  # slot of the first of what was kept
        self._kept: list[Array] = []

    def take(self, x: Sequence[float], y: Sequence[float], u: Sequence[float], w: Sequence[float]) -> None:
        """Take what a slot has come to: states, outputs, command and disturbance."""
        slots = self._slots
        slots.extend((*y, *u, *w))
        if len(slots) >= BLOCK * self._width:
            if self._width:
                self._block()
            else:
                self._width = len(slots)

    def _block(self) -> None:
        z, begin = np.array(self._slots).reshape(-1, self._width), self._next
        self._next += len(z)
        del self._slots[:]
        if self._past is not None:
            z, begin = np.concatenate([self._past, z]), begin - 1
        self._past = z[-1:]
        if self._next > MOST_KEPT and self._kept:
            return
        found = self._missed_in(z, begin, 0.0)
        self._compared, self._missed = self._compared + found.compared, self._missed + found.slots
        if self._kept or found.slots:
            self._first = self._first if self._kept else begin
            self._kept.append(z[1:] if self._kept else z)

    def _missed_in(self, z: Array, begin: int, lost: float) -> Missed:
        """Compare slots one behind the other, of which the first has the number `begin`; rounding has lost so much."""
        step = self._step
        N, n, width = step.flows.shape
        m = width - n
        known = np.concatenate([z[:-1, :n], z[:-1, -2 * m : -m] + z[:-1, -m:]], axis=1)
        finite = np.asarray((np.abs(z) < LARGEST).all(axis=1))
        modes = np.where(finite, z[:, -2 * m - 1], -1.0).astype(np.int64)
        at = np.flatnonzero((modes[1:] == modes[:-1]) & finite[:-1] & finite[1:])
        if not len(at):
            return Missed(0, 0, None)
        known, after, seen = known[at], z[1:, :n][at], modes[:-1][at] - 1
        every = [_beyond(step.flows[i], step.bands[i], known, after, lost) for i in range(N)]
        share, apart = (np.array(each) for each in zip(*every))
        mode = np.clip(seen, 0, N - 1) if step.seen else share.max(axis=2).argmin(axis=0)
        share, apart = share[mode, np.arange(len(at))], apart[mode, np.arange(len(at))]
        far = np.flatnonzero(share.max(axis=1) > EQUAL)
        for count, k in enumerate(far.tolist(), start=1):
            if _too_many(count, step.unseen * k):
                i = int(share[k].argmax())
                by = "{:.2g} {} ({})".format(apart[k, i], *reversed(step.names[i])).replace(" 1 (", " (")
                return Missed(len(at), len(far), (begin + int(at[k]) + 1, by))
        return Missed(len(at), len(far), None)

    def departed(self) -> tuple[int, str] | None:
        """Return the slot in which the plant left its modes, and by how much, once the run has ended; None if it did not."""
        if self._slots and (self._width or self._past is not None):
            self._block()
        if not self._kept or not _too_many(self._missed, self._step.unseen * self._compared):
            return None
        own = np.concatenate(self._kept)
        alone = self._alone(len(own), own.shape[1])
        own, m = own[: len(alone)], self._step.flows.shape[2] - self._step.flows.shape[1]
        n = self._step.flows.shape[1]
        other = np.flatnonzero(own[:, n] != alone[:, n])
        if len(other):
            return self._first + int(other[0]), "a mode that its inputs change"
        difference = own.copy()
        difference[:, :n] -= alone[:, :n]
        difference[:, -m:] = 0.0  # the disturbance is in both
        lost = CANCELS * float(np.abs(own[:, :n]).max(initial=0.0) + np.abs(alone[:, :n]).max(initial=0.0))
        return self._missed_in(difference, self._first, lost).left

    def _alone(self, slots: int, width: int) -> Array:
        """Return the record of a run without commands in the slots that were kept, as far as it goes."""
        run, rows, w = self._start(), [], self._disturbance(0)
        still = (0.0,) * len(w)
        for k in range(self._first + slots):
            try:
                if k:
                    run.advance(self._period_ns, still, w)
                y, w = run.measure(), self._disturbance(k)
            except Exception:  # whatever an author's plant does without commands: until there it is compared
                break
            if not abs(sum(y)) < LARGEST:
                break
            if k >= self._first:
                rows.append((*y, *still, *w))
        return np.array(rows, dtype=float).reshape(len(rows), width)


def _beyond(flow: Array, band: Array, known: Array, after: Array, lost: float) -> tuple[Array, Array]:
    """By how much the states after a slot leave their band: as a share of the terms of the sum, and as it is; (slots, n) each."""
    left, scale, allowed = after.copy(), np.abs(after), np.full_like(after, lost)
    for column in range(flow.shape[1]):  # in one order on every machine
        term = known[:, column : column + 1] * flow[:, column]
        left -= term
        scale += np.abs(term)
        allowed += np.abs(known[:, column : column + 1]) * band[:, column]
    apart = np.maximum(np.abs(left) - allowed, 0.0)
    return apart / (scale.max(axis=1, keepdims=True) + 1e-300), apart


def _too_many(count: int, mean: float) -> bool:
    """Whether so many jumps are too many, where so many are to be expected at most."""
    return count > max(FEW, mean) and count * log(count / max(mean, 1e-300)) - count + mean > -log(UNLIKELY)
