"""*Send all, apply one*: a packet carries one input per delay that it may meet, the actuator applies one (7.9)-(7.13).

*Send all, apply one* over several sensor nodes: the gain is chosen by the age of each node's newest sample.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import cycle
from math import prod
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from design.controllers.contract import (
    Gains,
    Known,
    KnownInBatch,
    LoopModel,
    MultiSampleController,
    Rows,
    RunningController,
    Selection,
    row_count,
)
from design.controllers.exact_products import dot
from design.controllers.gain_rows_many import BatchGainRows, Matrix, feedforward, sojourn_ranges
from design.errors import FieldError


class NodeGainRows:
    r"""u = u* + K[(\tau_1, \ldots, \tau_q), row] (y - r), y the newest sample of every output; see `MultiSampleController`.

    Until a packet of every node has come it answers zeros, as a controller of one node does before its first sample. It does not
    wait for a node that may keep silent by its trigger: its outputs count as 0, its age as 0.

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
        y, age, received = [0.0] * self._width, [0] * len(self._ages), set()
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


class NodeGainRowsOfMany:
    """The gains of every node's age in many runs, each bit for bit what `NodeGainRows` computes alone.

    Args:
        running: the rows of a table by its index.
        ages: how many ages of each node have tables.
    """

    def __init__(self, running: BatchGainRows, ages: Sequence[int]) -> None:
        self._running, self._counts = running, tuple(ages)
        self.selection: Selection = running.selection
        self.memory: int | None = None

    def rows(self, k: int, known: KnownInBatch) -> Matrix:
        """Return the rows of slot k, (rows, m, runs), by the age of every node's newest sample."""
        index = np.zeros(known.ages.shape[1], dtype=np.intp)
        for i, count in enumerate(self._counts):
            index = index * count + np.minimum(known.ages[min(i, len(known.ages) - 1)], count - 1)
        return self._running.rows(k, known._replace(ages=index[None]))


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
    errors of all earlier slots.
    """

    def __init__(
        self,
        K: NDArray[np.float64],
        selection: Selection,
        model: LoopModel,
        integral: bool = False,
        sojourns: Sequence[int] = (),
    ) -> None:
        self.selection = selection
        self._sum = [0.0] * model.C.shape[0] if integral else []
        self._gains = nested(K)
        self._gain_at = GainIndex(sojourns or (1,) * len(K)).at
        self._omega = tuple(tuple(map(float, row)) for row in feedforward(model))
        # One input, one output: the same sums without loops in loops, as a sweep runs this a million times.
        scalar = K.shape[2:] == (1, 1)
        self._scalars = [[mat[0][0] for mat in rows] for rows in self._gains] if scalar else None

    def rows(self, k: int, tau: int, y: Sequence[float], r: Sequence[float]) -> Rows:
        if self._scalars is not None:
            error, held = y[0] - r[0], self._omega[0][0] * r[0]
            return tuple([(held + g * error,) for g in self._scalars[self._gain_at(tau)]])
        e = [a - b for a, b in zip(y, cycle(r))]
        known = e + self._sum
        self._sum = [s + x for s, x in zip(self._sum, e)]
        star = [dot(row, r) for row in self._omega]
        return tuple(
            [tuple([s + dot(gains, known) for s, gains in zip(star, mat)]) for mat in self._gains[self._gain_at(tau)]]
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class SendAll:
    """*Send all, apply one* static output feedback with any table of gains (7.9)-(7.13).

    Args:
        gains: nested tuple [tau][row][m][p]. One gain matrix (m x p, input unit per output unit) for every measured tau and every
            row; one matrix for all of them is kind = "local".
        selection: which row the actuator applies; see the module's table.
        integral: the gains have p more columns, for the integral of the measured error (Remark 7.7).
        sojourns: how many tables belong to every tau, for 1, 2, ... slots that it has lasted (the last for all longer ones), over
            semi-Markov delays; by default one each, whatever it has lasted.
        samples: samples per packet: the gains have p columns for y(k - tau), then p for y(k - tau - 1), and so on.
        ages: several sensor nodes: how many ages 0, 1, ... of each node have tables of their own, those of the last node first
            (as digits count); by default a table belongs to the oldest of the nodes' ages.
    """

    kind: ClassVar[str] = "send-all"

    gains: Gains
    selection: Selection = "applied"
    integral: bool = False
    sojourns: tuple[int, ...] = ()
    samples: int = 1
    ages: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if self.samples < 1:
            raise FieldError("samples", f"{self.samples}, expected at least 1")
        if self.ages and (min(self.ages) < 1 or prod(self.ages) != len(self.gains)):
            raise FieldError("ages", f"{list(self.ages)}, expected counts whose product is {len(self.gains)}, one per table")
        if self.ages and self.sojourns:
            raise FieldError("sojourns", "needs one sensor node; with ages the tables belong to the ages of several nodes")
        try:
            shape = np.asarray(self.gains, dtype=float).shape
        except ValueError:
            shape = ()
        if len(shape) != 4:
            raise FieldError("gains", "expected [tau][row][m][p] with equal lengths")
        if self.sojourns and (min(self.sojourns) < 0 or sum(self.sojourns) != shape[0]):
            raise FieldError("sojourns", f"{list(self.sojourns)}, expected counts whose sum is the number of tables, {shape[0]}")

    def table(self, model: LoopModel) -> NDArray[np.float64]:
        K = np.asarray(self.gains, dtype=float)
        m, p = model.B.shape[1], model.C.shape[0]
        rows = row_count(self.selection, model.d_max)
        width = p * (self.samples + self.integral)
        if K.shape[1:] != (rows, m, width):
            raise FieldError(
                "gains",
                f"shape {list(K.shape)} does not fit the loop; expected [tau][{rows}][{m}][{width}] "
                f"for selection {self.selection!r} with d up to {model.d_max}, the max_age of network.ca",
            )
        if self.ages:
            count = len(model.nodes.names)
            if len(self.ages) != count:
                raise FieldError("ages", f"{list(self.ages)}, expected one number for each of {count} sensor nodes")
        elif len(self.sojourns or K) < model.tau_max + 1:
            raise FieldError("gains", f"{len(self.sojourns or K)} tables, but tau reaches {model.tau_max}")
        return K

    def start(self, model: LoopModel) -> RunningController | MultiSampleController:
        running = GainRows(self.table(model), self.selection, model, self.integral, self.sojourns)
        if len(self.ages) < 2:  # of one node, the age is tau itself
            return running
        return NodeGainRows(running, model, self.ages, row_count(self.selection, model.d_max))

    def start_batch(self, model: LoopModel, runs: int) -> BatchGainRows | NodeGainRowsOfMany | None:
        """Return so many of them, ready for slot 0; None over several nodes of which one may keep silent."""
        if len(self.ages) > 1 and model.nodes.silent:
            return None
        running = BatchGainRows(self.table(model), self.selection, model, runs, self.integral, self.sojourns)
        return running if len(self.ages) < 2 else NodeGainRowsOfMany(running, self.ages)


@dataclass(frozen=True, slots=True, kw_only=True)
class Local:
    """One gain for every delay: a design that ignores the network (thesis, Section 7.4.3: K = -0.4515).

    Args:
        gain: nested tuple [m][p]. Output feedback gain, input unit per output unit.
    """

    gain: tuple[tuple[float, ...], ...] = ((-0.4515,),)
    selection: Selection = field(default="constant", init=False)

    def table(self, model: LoopModel) -> NDArray[np.float64]:
        K = np.asarray(self.gain, dtype=float)
        m, p = model.B.shape[1], model.C.shape[0]
        if K.shape != (m, p):
            raise FieldError("gain", f"shape {list(K.shape)} does not fit the plant; expected [{m}][{p}]")
        return np.broadcast_to(K, (model.tau_max + 1, 1, m, p)).copy()

    def start(self, model: LoopModel) -> RunningController:
        return GainRows(self.table(model), self.selection, model)

    def start_batch(self, model: LoopModel, runs: int) -> BatchGainRows:
        """Return so many of them, ready for slot 0."""
        return BatchGainRows(self.table(model), self.selection, model, runs)


@dataclass(frozen=True, slots=True, kw_only=True)
class Constant:
    """The same input in every slot and for every row: for tests and for open-loop experiments.

    Args:
        value: tuple of float, length m. Input, in the plant's input unit.
    """

    value: tuple[float, ...] = (0.0,)

    def start(self, model: LoopModel) -> RunningController:
        if len(self.value) != model.B.shape[1]:
            raise FieldError("value", f"{len(self.value)} entries, but the plant has {model.B.shape[1]} inputs")
        return _ConstantRows(self.value)


class _ConstantRows:
    selection: Selection = "constant"

    def __init__(self, value: tuple[float, ...]) -> None:
        self._rows = (tuple(map(float, value)),)

    def rows(self, k: int, tau: int, y: Sequence[float], r: Sequence[float]) -> Rows:
        return self._rows
