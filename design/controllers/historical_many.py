"""Gains over historical data in many runs at once, each bit for bit what `HistoricalRun` computes alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from design.controllers.contract import Selection
from design.controllers.packet_window import PacketWindow
from design.controllers.sensor_nodes import Turns, Uses, phase_at

Matrix = NDArray[np.float64]
Integers = NDArray[np.intp]


class BatchHistorical:
    """u(k) = sum over j of K[phase, j] x(k - j) in many runs, in the order of the gains that are not zero.

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
        self.memory = K.shape[1] - 1
        self._turns, self._uses, self._window, self._delay = turns, uses, window, delay
        self._inputs, self._runs = K.shape[2], runs
        some = (K != 0.0).any(axis=0)
        self._entries = [(int(i), int(j), int(l), np.ascontiguousarray(K[:, j, i, l])) for j, i, l in np.argwhere(some)]
        self._came: dict[int, Integers] = {}  # who was heard, by slot of sending

    def rows_from_samples(self, k: int, fresh: NDArray[np.bool_], held: Matrix, r: Sequence[float]) -> Matrix:
        """Return u(k) as the one row, (1, m, runs); to be called in every slot.

        Args:
            k: slot.
            fresh: whether the sample of slot k - j of a node has come, (memory + 1, nodes, runs).
            held: newest sample of every output from slot k - j or before that has come, 0 without one, (memory + 1, p, runs).
            r: reference of the slot, (p,); not used.
        """
        phase, heard = self._phase(k, fresh)
        u = np.zeros((self._inputs, self._runs))
        for i, j, l, gains in self._entries:
            u[i] += gains.take(phase) * held[j, l]
        return (u if heard is None else np.where(heard, u, 0.0))[None]

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
                continue  # before slot 0 of a cycle everything counts as heard
            total += ((node < 0).astype(np.intp) if count else np.where(node < 0, base - 1, node)) * base**e
        return ((sent + turns.phase) % count + count * total if count else total), None
