"""The rows of *send all, apply one* in a loop, one slot after the other (7.9)-(7.13)."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle

import numpy as np
from numpy.typing import NDArray

from design.controllers.contract import Gains, Known, LoopModel, Rows, RunningController, Selection
from design.controllers.exact_products import dot
from design.controllers.gain_rows_many import feedforward, sojourn_ranges


def nested(K: NDArray[np.float64]) -> Gains:
    """Return K[tau, row, m, p] as the nested tuples that an experiment file holds."""
    return tuple(tuple(tuple(tuple(map(float, row)) for row in mat) for mat in rows) for rows in K)


class GainIndex:
    """Counts for how long the measured tau has lasted, and says which gain belongs to both.

    Args:
        sojourns: how many gains every tau has, for 1, 2, ... slots at this tau; the last one stands for all longer ones. A tau
            without gains, as of a packet that comes late, has those of the next larger one, beyond the end those of the last.
    """

    def __init__(self, sojourns: Sequence[int]) -> None:
        self._range = sojourn_ranges(sojourns)
        self._tau = self._index = self._last = -1

    def at(self, tau: int) -> int:
        """Return the index of the gain; called once a slot, in order."""
        if tau != self._tau:
            self._tau = tau
            self._index, self._last = self._range[tau] if tau < len(self._range) else self._range[-1]
        elif self._index < self._last:
            self._index += 1
        return self._index


class GainRows:
    """u = u* + K[tau, row] Y, see `GainIndex`.

    Y is the error y - r of every sample in the packet, newest first, and with ``integral`` below these the sum of the newest
    errors of all earlier slots; where it has a `limit` for each output, the sum is clamped to it in every slot.
    """

    def __init__(
        self,
        K: NDArray[np.float64],
        selection: Selection,
        model: LoopModel,
        integral: bool = False,
        sojourns: Sequence[int] = (),
        limit: Sequence[float] = (),
    ) -> None:
        self.selection = selection
        self._limit = tuple(map(float, limit))
        self._sum = [0.0] * model.C.shape[0] if integral else []
        self._gains = nested(K)
        self._index = GainIndex(sojourns or (1,) * len(K))
        self._omega = tuple(tuple(map(float, row)) for row in feedforward(model))
        # One input, one output: the same sums without loops in loops, 18 % of an interpreted virtual slot.
        scalar = K.shape[2:] == (1, 1)
        self._scalars = [[mat[0][0] for mat in rows] for rows in self._gains] if scalar else None

    def rows(self, k: int, tau: int, y: Sequence[float], r: Sequence[float]) -> Rows:
        if self._scalars is not None:
            error, held = y[0] - r[0], self._omega[0][0] * r[0]
            return tuple([(held + g * error,) for g in self._scalars[self._index.at(tau)]])
        e = [a - b for a, b in zip(y, cycle(r))]
        known = e + self._sum
        self._sum = [s + x for s, x in zip(self._sum, e)]
        if self._limit:
            self._sum = [min(max(s, -most), most) for s, most in zip(self._sum, self._limit)]
        star = [dot(row, r) for row in self._omega]
        return tuple(
            [tuple([s + dot(gains, known) for s, gains in zip(star, mat)]) for mat in self._gains[self._index.at(tau)]]
        )


class NodeGainRows:
    r"""u = u* + K[(\tau_1, \ldots, \tau_q), row] (y - r), y the newest sample of every output; see `MultiSampleController`.

    Until a packet of every node has come it answers zeros, as a controller of one node does before its first sample. It does not
    wait for a node that may keep silent by its trigger or its clock: its outputs count as 0, its age as the oldest.

    Args:
        running: the rows of a table by its index; it takes the index where it expects tau.
        model: the loop, with its sensor nodes.
        ages: how many ages of each node have tables; an older sample has the gains of the oldest.
        rows: rows of a packet.
    """

    memory = 0

    def __init__(self, running: RunningController, model: LoopModel, ages: Sequence[int], rows: int) -> None:
        nodes = model.nodes
        self.selection = running.selection
        self._rows, self._ages, self._outputs = running.rows, tuple(ages), nodes.outputs
        self._waited = {i for i, name in enumerate(nodes.names) if name not in nodes.silent}
        self._none: Rows = ((0.0,) * model.B.shape[1],) * rows
        self._width = model.C.shape[0]

    def rows(self, k: int, known: Known) -> Rows:
        """Return the rows of slot k; see `MultiSampleController.rows`."""
        y, age, received = [0.0] * self._width, [count - 1 for count in self._ages], set()
        for node, slot, values in known.samples:  # newest first
            if node not in received:
                received.add(node)
                age[node] = k - slot
                for output, value in zip(self._outputs[node], values):
                    y[output] = value
        if not self._waited <= received:
            return self._none
        index = 0
        for own, count in zip(age, self._ages):
            index = index * count + min(own, count - 1)
        return self._rows(k, index, y, known.reference)
