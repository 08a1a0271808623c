"""*Send all, apply one* over several sensor nodes: the gain is chosen by the age of each node's newest sample."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from design.controllers.contract import Known, LoopModel, Rows, RunningController, Selection
from design.controllers.gain_rows_many import BatchGainRows, Matrix


class NodeGainRows:
    r"""u = u* + K[(\tau_1, \ldots, \tau_q), row] (y - r), y the newest sample of every output; see `MultiSampleController`.

    Until every node has been heard it answers zeros, as a controller of one node does before its first sample. A node that may
    keep silent by its trigger is not waited for: its outputs count as 0, its age as 0.

    Args:
        running: the rows of a table by its index; it is told the index where it expects tau.
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
        y, age, heard = [0.0] * self._width, [0] * len(self._ages), set()
        for node, slot, values in known.samples:  # newest first
            if node not in heard:
                heard.add(node)
                age[node] = k - slot
                for output, value in zip(self._outputs[node], values):
                    y[output] = value
        if not self._waited <= heard:
            return self._none
        index = 0
        for own, count in zip(age, self._ages):
            index = index * count + min(own, count - 1)
        return self._rows(k, index, y, known.reference)


class NodeGainRowsOfMany:
    """The gains of every node's age in many runs, each bit for bit what `NodeGainRows` computes alone.

    Args:
        running: the rows of a table by its index.
        ages: how many ages of each node have tables.
    """

    def __init__(self, running: BatchGainRows, ages: Sequence[int]) -> None:
        self._running, self._counts = running, tuple(ages)
        self.selection: Selection = running.selection

    def rows(self, k: int, started: NDArray[np.bool_], tau: NDArray[np.intp], y: Matrix, r: Sequence[float]) -> Matrix:
        """Return the rows where all nodes are equally old; see `rows_by_node`."""
        return self.rows_by_node(k, started, np.broadcast_to(tau, (len(self._counts), *tau.shape)), y, r)

    def rows_by_node(
        self, k: int, started: NDArray[np.bool_], ages: NDArray[np.intp], y: Matrix, r: Sequence[float]
    ) -> Matrix:
        """Return the rows of slot k, (rows, m, runs); where a run has not started they mean nothing and change nothing.

        Args:
            k: slot.
            started: whether every node has been heard, (runs,).
            ages: of the newest sample of every node, samples, (nodes, runs).
            y: newest sample of every output, (p, runs).
            r: reference of the slot, (p,).
        """
        index = np.zeros(ages.shape[1], dtype=np.intp)
        for age, count in zip(ages, self._counts):
            index = index * count + np.minimum(age, count - 1)
        return self._running.rows(k, started, index, y, r)
