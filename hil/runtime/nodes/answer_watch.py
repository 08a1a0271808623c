"""Whether a controller that runs keeps to its table: every answer beside that of what it says that it is, asked the same.

Where references are stated, both are asked again with samples of zero: what they answer to the samples is what is compared. What
the controller adds of its own may be anything that stays bounded while the reference stays: it enters the loop as an input, which
moves a stable loop by a bounded amount. While the reference stays, the largest value so far is looked at: one that rises in the
last third of the time as fast as in the first, slot after slot, is not seen to have a bound.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any, Final

from design.controllers import Known, LoopModel, MultiSampleController, Rows
from design.controllers.contract import Controller
from hil.rig.watched import EQUAL, Running, handed, looks_back

LEAST: Final = 60
"""Slots of one reference below which nothing is said."""
SHARE: Final = 0.9
"""Rise in the last third beside that in the first: 1 of a ramp, 0.9 of a filter 6 times slower than the time looked at."""
RISES: Final = 4
"""Slots of the last third in which a bounded one may reach a new largest value: steps of its own, and records of a noise."""
TIMES: Final = 2.5
"""How many times the largest value of the first third is passed: 3 by a ramp."""


class OwnFeedforward:
    """Keeps the largest value that was added so far, slot by slot, while one reference stays.

    Attributes:
        grown: the slot from which it rose without a bound, and how far; None while it did not.
    """

    def __init__(self) -> None:
        self._aim: Sequence[float] = ()
        self._first = 0
        self._largest = array("d")
        self.grown: tuple[int, str] | None = None

    def take(self, k: int, aim: Sequence[float], size: float) -> None:
        """Take the largest value that was added in a slot.

        Args:
            k: slot.
            aim: reference.
            size: largest absolute value over rows and inputs, in units of the inputs.
        """
        if aim != self._aim or not self._largest:
            self.judge()
            self._aim, self._first, self._largest = tuple(aim), k, array("d")
        last = self._largest[-1] if self._largest else 0.0
        self._largest.append(size if not size <= last else last)

    def judge(self) -> tuple[int, str] | None:
        """Return the slot from which it rose without a bound and how far, once the run or a reference has ended; else None."""
        seen = self._largest
        count, third = len(seen), len(seen) // 3
        if self.grown is not None or count < LEAST or not seen[-1] >= TIMES * seen[third - 1]:
            return self.grown
        tail = seen[-third - 1 :]
        least = 1e-9 * seen[-1]
        rises = sum(b - a > least for a, b in pairwise(tail))
        if rises > RISES and tail[-1] - tail[0] >= SHARE * (seen[third - 1] - seen[0]):
            grew = f"to {seen[third - 1]:.2g} in {third} slots and to {seen[-1]:.2g} in {count}"
            self.grown = self._first + count - third, f"what it adds on samples of zero, which grows {grew}"
        return self.grown


ROUNDING = 1e-12


class AnswerWatch:
    """Asks a controller, and beside it what the controller says that it is.

    Args:
        own: the controller that runs.
        controller: the same, to be started again.
        stated: what it says that it is.
        model: what both know of the loop.
        aims: whether references are stated.
    """

    def __init__(
        self, own: Running, controller: Controller, stated: Controller, model: LoopModel, *, aims: bool
    ) -> None:
        twin = stated.start(model)
        self._by_samples = isinstance(own, MultiSampleController)
        self._own: Callable[..., Rows] = own.rows
        self._twin: Callable[..., Rows] = twin.rows
        self._still: tuple[Callable[..., Rows], Callable[..., Rows]] | None = None
        if aims:
            self._still = controller.start(model).rows, stated.start(model).rows
        self._largest = 0.0
        self._left: tuple[int, str] | None = None
        self._added = OwnFeedforward()
        if looks_back(own) != looks_back(twin):
            self._left = 0, f"what it is handed: it {handed(own)}, and what it states {handed(twin)}"

    @property
    def departed(self) -> tuple[int, str] | None:
        """The slot in which the answers left the table, and by how much; None while they did not."""
        return self._left or self._added.judge()

    def rows(self, *asked: Any) -> Rows:
        """Return what the controller answers; see `RunningController.rows` and `MultiSampleController.rows`."""
        found = self._own(*asked)
        if self._left is None:
            expected = self._twin(*asked)
            still = None
            if self._still is not None:
                at_rest = self._at_rest(asked)
                still = self._still[0](*at_rest), self._still[1](*at_rest)
                aim = asked[-1].reference if self._by_samples else asked[-1]
                self._added.take(asked[0], aim, _apart(*still))
            if found != expected:
                self._compare(asked[0], found, expected, still)
        return found

    def _at_rest(self, asked: tuple[Any, ...]) -> tuple[Any, ...]:
        if not self._by_samples:
            k, tau, y, r = asked
            return k, tau, (0.0,) * len(y), r
        k, known = asked
        return k, Known(tuple(s._replace(values=(0.0,) * len(s.values)) for s in known.samples), known.reference)

    def _compare(self, k: int, found: Rows, expected: Rows, still: tuple[Rows, Rows] | None) -> None:
        if [len(row) for row in found] != [len(row) for row in expected]:
            self._left = k, "rows of another number"
            return
        lost, worst = 0.0, 0.0
        largest = self._largest
        for i, (row, by_table) in enumerate(zip(found, expected)):
            for j, (a, b) in enumerate(zip(row, by_table)):
                if still is not None:
                    own, stated = still[0][i][j], still[1][i][j]
                    a, b, lost = a - own, b - stated, max(lost, ROUNDING * (abs(own) + abs(stated)))
                largest = max(largest, abs(b))
                apart = abs(a - b)
                worst = apart if not apart <= worst else worst  # what is no number is the worst
        if largest < float("inf"):
            self._largest = largest
        if not worst <= EQUAL * largest + lost:
            self._left = k, f"{worst:.2g} where the table says {largest:.2g} at most"


def _apart(own: Rows, stated: Rows) -> float:
    """Return by how much answers to samples of zero differ at most; 0 where by rounding alone."""
    if own == stated:
        return 0.0
    pairs = [(a, b) for row, by_table in zip(own, stated) for a, b in zip(row, by_table)]
    return max((abs(a - b) for a, b in pairs if not abs(a - b) <= ROUNDING * (abs(a) + abs(b))), default=0.0)
