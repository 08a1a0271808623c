"""The Smith predictor that the thesis compares with, for a loop with delays on both sides."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from design.controllers import LoopModel, Rows, RunningController, Selection, feedforward
from design.errors import FieldError


@dataclass(frozen=True, slots=True, kw_only=True)
class Smith:
    """Smith predictor for the S-C delay, *send all, apply one* for the C-A delay (thesis, Figure 7.4, [212]).

    A model of the plant, driven by the nominal rows, gives the undelayed output; the delayed measurement corrects its
    bias. Row d of the packet is the control for the d-step-ahead prediction, so the row is chosen by d at application.

    Args:
        gain: nested tuple [m][p]. Local output feedback gain. The default is cautious: 3 % overshoot on the motor.
    """

    gain: tuple[tuple[float, ...], ...] = ((-0.03,),)

    def start(self, model: LoopModel) -> RunningController:
        K = np.asarray(self.gain, dtype=float)
        m, p = model.B.shape[1], model.C.shape[0]
        if K.shape != (m, p):
            raise FieldError("gain", f"shape {list(K.shape)} does not fit the plant; expected [{m}][{p}]")
        return _SmithRows(K, model)

    def start_many(self, model: LoopModel, runs: int) -> SmithOfMany:
        """Return so many of them, ready for slot 0."""
        return SmithOfMany(np.asarray(self.gain, dtype=float), model, runs)


class _SmithRows:
    selection: Selection = "applied"

    def __init__(self, K: NDArray[np.float64], model: LoopModel) -> None:
        self._K, self._model, self._omega = K, model, feedforward(model)
        self._x = np.zeros(model.A.shape[0])
        self._past: deque[NDArray[np.float64]] = deque([model.C @ self._x], maxlen=64)  # model outputs, newest last
        self._k: int | None = None
        self._u = np.zeros(model.B.shape[1])

    def rows(self, k: int, tau: int, y: Sequence[float], r: Sequence[float]) -> Rows:
        A, B, C = self._model.A, self._model.B, self._model.C
        if self._k is not None:
            for _ in range(k - self._k):  # a slot whose packet was lost still passes for the model
                self._x = A @ self._x + B @ self._u
                self._past.append(C @ self._x)
        self._k = k
        bias = np.asarray(y) - self._past[-1 - min(tau, len(self._past) - 1)]
        ref = np.asarray(r)
        star = self._omega @ ref
        x, rows = self._x, []
        for _ in range(self._model.d_max + 1):
            u = star + self._K @ (C @ x + bias - ref)
            rows.append(tuple(map(float, u)))
            x = A @ x + B @ u
        self._u = np.asarray(rows[0])
        return tuple(rows)


class SmithOfMany:
    """The predictor in many runs, with the products of `_SmithRows` for each of them.

    Args:
        K: gain, (m, p).
        model: the loop.
        runs: how many.
    """

    selection: Selection = "applied"

    def __init__(self, K: NDArray[np.float64], model: LoopModel, runs: int) -> None:
        self._K, self._model, self._omega = K, model, feedforward(model)
        self._x = np.zeros((runs, model.A.shape[0], 1))
        self._u = np.zeros((runs, model.B.shape[1], 1))
        self._past = np.zeros((64, runs, model.C.shape[0], 1))  # model outputs, the newest first
        self._past[0] = model.C @ self._x
        self._held = np.ones(runs, dtype=np.intp)
        self._ran = np.zeros(runs, dtype=np.bool_)

    def rows(
        self, k: int, started: NDArray[np.bool_], tau: NDArray[np.intp], y: NDArray[np.float64], r: Sequence[float]
    ) -> NDArray[np.float64]:
        """Return the rows of slot k, (rows, m, runs); see `GainRowsOfMany.rows`."""
        A, B, C = self._model.A, self._model.B, self._model.C
        ran = self._ran[:, None, None]
        self._x = np.where(ran, A @ self._x + B @ self._u, self._x)
        newer = np.concatenate(((C @ self._x)[None], self._past[:-1]))
        self._past = np.where(ran, newer, self._past)
        self._held = np.minimum(self._held + self._ran, 64)
        self._ran = started.copy()
        bias = np.ascontiguousarray(y.T)[:, :, None] - self._past[np.minimum(tau, self._held - 1), np.arange(len(tau))]
        ref = np.asarray(r)
        star = (self._omega @ ref)[:, None]
        x, rows = self._x, []
        for _ in range(self._model.d_max + 1):
            u = star + self._K @ (C @ x + bias - ref[:, None])
            rows.append(u[:, :, 0].T)
            if len(rows) == 1:
                self._u = np.where(started[:, None, None], u, self._u)
            x = A @ x + B @ u
        return np.stack(rows)
