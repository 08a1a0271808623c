"""Whether a controller that runs keeps to its table: every answer beside that of what it says that it is, asked the same.

Where references are stated, both are asked again with samples of zero: what they answer to the samples is what is compared, and
what the controller adds of its own is looked at apart, see `own_feedforward`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from design.controllers import Known, LoopModel, MultiSampleController, Rows
from design.controllers.contract import Controller
from hil.certify.answers_test import Running
from hil.certify.motion_test import EQUAL
from hil.certify.stated_controller import handed, looks_back
from hil.runtime.nodes.own_feedforward import OwnFeedforward

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
