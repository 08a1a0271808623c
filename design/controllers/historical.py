r"""Gains over the historical data of scheduled sensor nodes, in the loop (Chapter 5).

.. math:: u(k) = \sum_{j=0}^{\tau} K(I(k), j)\, x(k - j)

The phase I(k) is a turn of the schedule, which the controller knows from the slot; over random turns it is the node whose
packet came. An entry of K may differ from zero only where x_l(k - j) has arrived: the zero-element constraints (5.8).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from design.controllers.contract import Gains, Known, KnownInBatch, LoopModel, Rows, Selection
from design.controllers.sensor_nodes import PacketWindow, SensorNodes, Turns, Uses, phase_at, window_of
from design.errors import FieldError

Matrix = NDArray[np.float64]
Integers = NDArray[np.intp]


class BatchHistorical:
    """u(k) = sum over j of K[phase, j] x(k - j) in many runs, in the order of the gains that are not zero.

    Each run has bit for bit what `HistoricalRun` computes alone.

    Args:
        K: gains, (phases, j, m, p).
        turns: who may send when.
        uses: which samples count, see `design.controllers.historical.Historical`.
        window: outcomes of the last slots, for ``last-packets``.
        delay: constant delay of a packet, slots, less than the gains look back; read where packets count by their slot.
        runs: how many.
    """

    selection: Selection = "constant"

    def __init__(
        self, K: Matrix, turns: Turns | None, uses: Uses, window: PacketWindow | None, delay: int, runs: int
    ) -> None:  # fmt: skip
        self.memory: int | None = K.shape[1] - 1
        self._turns, self._uses, self._window, self._delay = turns, uses, window, delay
        self._inputs, self._runs = K.shape[2], runs
        some = (K != 0.0).any(axis=0)
        self._entries = [(int(i), int(j), int(l), np.ascontiguousarray(K[:, j, i, l])) for j, i, l in np.argwhere(some)]
        self._came: dict[int, Integers] = {}  # whose packet came, by slot of sending

    def rows(self, k: int, known: KnownInBatch) -> Matrix:
        """Return u(k) as the one row, (1, m, runs); to be called in every slot."""
        held = known.held
        phase, received = self._phase(k, known.fresh)
        u = np.zeros((self._inputs, self._runs))
        for i, j, l, gains in self._entries:
            u[i] += gains.take(phase) * held[j, l]
        return (u if received is None else np.where(received, u, 0.0))[None]

    def _phase(self, k: int, fresh: NDArray[np.bool_]) -> tuple[int | Integers, NDArray[np.bool_] | None]:
        """Return the phase, and in which runs there is one: None for all."""
        turns, sent = self._turns, k - self._delay
        if self._window is not None:
            return self._outcomes(self._window, sent, fresh)
        if self._uses == "history" or turns is None:
            return phase_at(turns, k), None
        if turns.order:
            phase = phase_at(turns, sent)
            return phase, fresh[self._delay, turns.order[phase]] & (sent >= 0)
        came = fresh[self._delay]
        return came.argmax(axis=0), came.any(axis=0) & (sent >= 0)

    def _outcomes(
        self, window: PacketWindow, sent: int, fresh: NDArray[np.bool_]
    ) -> tuple[int | Integers, NDArray[np.bool_] | None]:
        """Return the phases of the last outcomes, see `PacketWindow.phase`."""
        if sent < 0:
            return 0, np.zeros(self._runs, dtype=np.bool_)
        came = fresh[self._delay]
        self._came[sent] = np.where(came.any(axis=0), came.argmax(axis=0), -1)
        if sent > window.length:
            self._came.pop(sent - window.length, None)
        turns, count, base = window.turns, len(window.turns.order), window.base
        total = np.zeros(self._runs, dtype=np.intp)
        for e in range(window.length):
            node = self._came.get(sent - e if count else max(sent - e, 0))
            if node is None:
                continue  # before slot 0 of a cycle every packet counts as received
            total += ((node < 0).astype(np.intp) if count else np.where(node < 0, base - 1, node)) * base**e
        return ((sent + turns.phase) % count + count * total if count else total), None


@dataclass(frozen=True, slots=True, kw_only=True)
class Historical:
    """Gains K[phase][j][m][p] on the outputs of j slots ago, for every turn of the schedule.

    Args:
        gains: nested tuple [phase][j][m][p]. Input unit per output unit.
        uses: ``history``: all that has come; a sample that is missing is held from the one before. ``current-packet``: the packet
            of this slot only; without one the input is 0. ``last-packets``: those of the last slots, as many as the number of
            phases says, with gains of their own for every outcome; see `design.controllers.sensor_nodes`.
    """

    kind: ClassVar[str] = "historical"

    gains: Gains
    uses: Uses = "history"

    def __post_init__(self) -> None:
        self.history()

    def history(self) -> NDArray[np.float64]:
        """Return K[phase, j, m, p].

        Raises:
            ValueError: rows of different lengths, or an entry that is not finite.
        """
        for i, phase in enumerate(self.gains):
            shapes = {(len(rows), *map(len, rows)) for rows in phase}
            if len(phase) != len(self.gains[0]) or len(shapes) != 1 or 0 in {n for shape in shapes for n in shape}:
                raise FieldError(f"gains[{i}]", "expected as many matrices as gains[0], all of one shape m x p")
        try:
            K = np.array(self.gains, dtype=float)
        except ValueError:
            raise FieldError("gains", "expected [phase][j][m][p] with equal lengths") from None
        if K.ndim != 4 or not K.size:
            raise FieldError("gains", "expected [phase][j][m][p], at least one of each")
        for at in np.argwhere(~np.isfinite(K))[:1]:
            raise FieldError(f"gains{''.join(f'[{i}]' for i in at)}", f"{K[tuple(at)]}, expected a finite number")
        return K

    def start(self, model: LoopModel) -> HistoricalRun:
        """Return the controller, ready for slot 0.

        Raises:
            ValueError: gains that do not fit the plant or its nodes.
        """
        return HistoricalRun(*self._fitting(model))

    def start_batch(self, model: LoopModel, runs: int) -> BatchHistorical | None:
        """Return a batch of `runs` controllers, ready for slot 0; None where a packet comes later than the gains look back."""
        K, nodes, uses, window = self._fitting(model)
        delay = nodes.delays[0] or 0
        return BatchHistorical(K, nodes.turns, uses, window, delay, runs) if uses == "history" or delay < K.shape[1] else None

    def _fitting(self, model: LoopModel) -> tuple[NDArray[np.float64], SensorNodes, Uses, PacketWindow | None]:
        K, nodes = self.history(), model.nodes
        m, p = model.B.shape[1], model.C.shape[0]
        if K.shape[2:] != (m, p):
            raise FieldError("gains", f"{K.shape[2]} x {K.shape[3]} matrices, expected {m} x {p}: inputs and outputs")
        if nodes.mixed:
            raise FieldError("gains", "over historical data need all nodes on one medium, or none on any")
        if self.uses == "last-packets":
            if nodes.turns is None or len(set(nodes.delays)) != 1 or None in nodes.delays:
                raise FieldError("uses", "the last packets need nodes that take turns and have one constant delay")
            return K, nodes, self.uses, window_of(nodes.turns, len(K))
        phases = 1 if nodes.turns is None else nodes.turns.phases
        if len(K) != phases:
            raise FieldError("gains", f"{len(K)} phases, but the schedule has {phases}")
        alone = nodes.turns is not None and not nodes.turns.received  # one packet in a slot
        if self.uses == "current-packet" and (not alone or len(set(nodes.delays)) != 1 or None in nodes.delays):
            raise FieldError("uses", "the current packet needs nodes that take turns and have one constant delay")
        if nodes.turns is not None and nodes.turns.transition and self.uses == "history":
            raise FieldError("uses", "over random turns only the current packet has gains of its own: uses = 'current-packet'")
        return K, nodes, self.uses, None


class HistoricalRun:
    """The controller while it runs, see `design.controllers.contract.MultiSampleController`."""

    def __init__(self, K: NDArray[np.float64], nodes: SensorNodes, uses: Uses, window: PacketWindow | None = None) -> None:
        self._window = window
        self._came: dict[int, int] = {}  # by slot of sending, of the window and slot 0
        self.selection: Selection = "constant"
        self.memory = K.shape[1] - 1
        self._inputs, self._uses, self._turns = K.shape[2], uses, nodes.turns
        self._delay = nodes.delays[0] or 0
        self._buffers, self._outputs = nodes.buffers, nodes.outputs
        # Per phase the entries that are not zero: (input, age, node, position in the node's sample, gain).
        position = {output: (n, at) for n, own in enumerate(nodes.outputs) for at, output in enumerate(own)}
        self._entries = [
            [(int(i), int(j), *position[int(l)], float(phase[j, i, l])) for j, i, l in np.argwhere(phase != 0.0)] for phase in K
        ]

    def rows(self, k: int, known: Known) -> Rows:
        """Return u(k) as the one row; see `MultiSampleController.rows`."""
        at: dict[int, dict[int, tuple[float, ...]]] = {}
        for node, slot, values in known.samples:
            at.setdefault(node, {})[slot] = values
        phase = self._phase(k, at)
        u = [0.0] * self._inputs
        for i, j, node, position, gain in self._entries[phase] if phase is not None else ():
            value = self._held(at.get(node), k - j)
            if value is not None:
                u[i] += gain * value[position]
        return (tuple(u),)

    def _phase(self, k: int, at: dict[int, dict[int, tuple[float, ...]]]) -> int | None:
        turns, sent = self._turns, k - self._delay
        if self._window is not None:
            return self._outcomes(self._window, sent, at)
        if self._uses == "history" or turns is None:
            return phase_at(turns, k)
        if turns.order:  # whose turn it was is known from the slot; whether its packet came, from the samples
            phase = phase_at(turns, sent)
            return phase if sent in at.get(turns.order[phase], ()) else None
        return next((node for node, samples in at.items() if sent in samples), None)

    def _outcomes(self, window: PacketWindow, sent: int, at: dict[int, dict[int, tuple[float, ...]]]) -> int | None:
        if sent < 0:
            return None
        node = next((node for node, samples in at.items() if sent in samples), None)  # nothing newer can have come
        if node is not None:
            self._came[sent] = node
        for slot in [slot for slot in self._came if 0 < slot <= sent - window.length]:
            del self._came[slot]
        return window.phase(sent, self._came.get)

    @staticmethod
    def _held(samples: dict[int, tuple[float, ...]] | None, slot: int) -> tuple[float, ...] | None:
        """The sample of a slot, or the newest before it; before slot 0 everything was zero."""
        if samples is None or slot < 0:
            return None
        exact = samples.get(slot)
        if exact is not None:
            return exact
        newest = max((s for s in samples if s <= slot), default=-math.inf)
        return samples[int(newest)] if newest >= 0 else None
