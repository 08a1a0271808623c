"""Compares every answer of a running controller with that of the controller that it states, from the same samples.

With references, each controller is also evaluated at samples of zero, and that answer is subtracted: the feedback must agree. The
feedforward, which is left, need not: it is an input of the loop, and a bounded input moves a stable loop by a bounded amount. It
counts as unbounded if, under a constant reference, its largest value so far rises in the last third of the time as fast as in
the first third, in more than a few slots.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Sequence
from itertools import pairwise
from math import inf
from typing import Any, Final

from design.controllers import Known, LoopModel, MultiSampleController, Rows
from design.controllers.contract import Controller
from hil.rig.loop import EQUAL, Running, handed, looks_back
from hil.runtime.nodes.controller_input import in_tuples

LEAST: Final = 60
"""Slots of one reference below which the feedforward is not judged."""
SHARE: Final = 0.9
"""Ratio of the rise in the last third to that in the first: 1 of a ramp, 0.9 of a filter 6 times slower than the whole time."""
RISES: Final = 4
"""Slots of the last third in which a bounded feedforward may reach a new largest value: by its own steps, or by noise."""
TIMES: Final = 2.5
"""Ratio of the largest value at the end to that after the first third: 3 of a ramp."""


class OwnFeedforward:
    """Keeps the largest feedforward so far, slot by slot, under a constant reference.

    Attributes:
        grown: the slot from which it rose without a bound, and a phrase that says how far; None while it did not.
    """

    def __init__(self) -> None:
        self._reference: Sequence[float] = ()
        self._first = 0
        self._largest = array("d")
        self.grown: tuple[int, str] | None = None

    def take(self, k: int, reference: Sequence[float], magnitude: float) -> None:
        """Take the feedforward of a slot.

        Args:
            k: slot.
            reference: of the slot.
            magnitude: largest absolute value over rows and inputs, in units of the inputs.
        """
        if reference != self._reference or not self._largest:
            self.judge()
            self._reference, self._first, self._largest = tuple(reference), k, array("d")
        last = self._largest[-1] if self._largest else 0.0
        self._largest.append(magnitude if not magnitude <= last else last)

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
    """Evaluates the running controller and the stated one, and compares their rows.

    Args:
        running: the controller that runs.
        controller: starts the running controller once more, for samples of zero.
        stated: the controller that it states.
        model: what both know of the loop.
        has_reference: whether the experiment has references.
    """

    def __init__(
        self, running: Running, controller: Controller, stated: Controller, model: LoopModel, *, has_reference: bool
    ) -> None:
        stated_run = stated.start(model)
        self._by_samples = isinstance(running, MultiSampleController)
        self._running_rows = in_tuples(running)
        self._stated_rows: Callable[..., Rows] = stated_run.rows
        self._at_zero_samples: tuple[Callable[..., Rows], Callable[..., Rows]] | None = None
        if has_reference:
            self._at_zero_samples = in_tuples(controller.start(model)), stated.start(model).rows
        self._largest = 0.0
        self._departed: tuple[int, str] | None = None
        self._feedforward = OwnFeedforward()
        if looks_back(running) != looks_back(stated_run):
            self._departed = 0, f"what it is handed: it {handed(running)}, and what it states {handed(stated_run)}"

    @property
    def departed(self) -> tuple[int, str] | None:
        """The slot in which the answers first differed from the stated ones, and by how much; None while they agree."""
        return self._departed or self._feedforward.judge()

    def rows(self, *arguments: Any) -> Rows:
        """Return what the controller answers; see `RunningController.rows` and `MultiSampleController.rows`."""
        answer = self._running_rows(*arguments)
        if self._departed is None:
            expected = self._stated_rows(*arguments)
            at_zero = None
            if self._at_zero_samples is not None:
                zeroed = self._with_zero_samples(arguments)
                at_zero = self._at_zero_samples[0](*zeroed), self._at_zero_samples[1](*zeroed)
                reference = arguments[-1].reference if self._by_samples else arguments[-1]
                self._feedforward.take(arguments[0], reference, _largest_difference(*at_zero))
            if answer != expected:
                self._compare(arguments[0], answer, expected, at_zero)
        return answer

    def _with_zero_samples(self, arguments: tuple[Any, ...]) -> tuple[Any, ...]:
        if not self._by_samples:
            k, tau, y, r = arguments
            return k, tau, (0.0,) * len(y), r
        k, known = arguments
        return k, Known(tuple(s._replace(values=(0.0,) * len(s.values)) for s in known.samples), known.reference)

    def _compare(self, k: int, answer: Rows, expected: Rows, at_zero: tuple[Rows, Rows] | None) -> None:
        if [len(row) for row in answer] != [len(row) for row in expected]:
            self._departed = k, "rows of another number"
            return
        lost, worst = 0.0, 0.0
        largest = self._largest
        for i, (row, by_table) in enumerate(zip(answer, expected)):
            for j, (a, b) in enumerate(zip(row, by_table)):
                if at_zero is not None:
                    running, stated = at_zero[0][i][j], at_zero[1][i][j]
                    a, b, lost = a - running, b - stated, max(lost, ROUNDING * (abs(running) + abs(stated)))
                if not abs(b) < inf:  # of a sample that is not finite: the table has no answer
                    continue
                largest = max(largest, abs(b))
                apart = abs(a - b)
                worst = apart if not apart <= worst else worst  # what is no number is the worst
        self._largest = largest
        if not worst <= EQUAL * largest + lost:
            self._departed = k, f"{worst:.2g} where the table says {largest:.2g} at most"


def _largest_difference(running: Rows, stated: Rows) -> float:
    """Return the largest difference of answers to samples of zero; 0 where it is rounding alone."""
    if running == stated:
        return 0.0
    pairs = [(a, b) for row, by_table in zip(running, stated) for a, b in zip(row, by_table)]
    return max((abs(a - b) for a, b in pairs if not abs(a - b) <= ROUNDING * (abs(a) + abs(b))), default=0.0)
