"""The Smith predictor that the thesis compares with, for a loop with delays on both sides."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from design.controllers import LoopModel, Rows, RowsLaw, RunningController, Selection, feedforward
from design.controllers.contract import KnownInBatch
from design.controllers.exact_products import Matrix, product, product_of_batch
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
        return _SmithRows(self.gain, model)

    def laws_of_ages(self, model: LoopModel, ages: int) -> tuple[RowsLaw, ...]:
        """Return its matrices for every age; state: the model's, then the model's outputs of the last slots, newest first."""
        A, B, C, K = model.A, model.B, model.C, np.asarray(self.gain, dtype=float)
        n, p, past = len(A), len(C), ages - 1
        order = n + past * p
        shift = np.zeros((order, order))
        shift[:n, :n] = A
        if past:
            shift[n : n + p, :n] = C
            shift[n + p :, n : order - p] = np.eye((past - 1) * p)
        laws = []
        for age in range(ages):
            bias = np.hstack([np.zeros((p, order)), np.eye(p)])  # y less the model's output of that slot, of (xi, y)
            if age:
                bias[:, n + (age - 1) * p : n + age * p] -= np.eye(p)
            else:
                bias[:, :n] -= C
            x, rows = np.eye(n, order + p), []
            for _ in range(model.d_max + 1):
                rows.append(K @ (C @ x + bias))
                x = A @ x + B @ rows[-1]
            moved = np.hstack([shift, np.zeros((order, p))])
            moved[:n] += B @ rows[0]
            table = np.array(rows)
            laws.append(RowsLaw(A=moved[:, :order], B=moved[:, order:], C=table[:, :, :order], D=table[:, :, order:]))
        return tuple(laws)

    def start_batch(self, model: LoopModel, runs: int) -> BatchSmith:
        """Return a batch of `runs` controllers, ready for slot 0."""
        return BatchSmith(np.asarray(self.gain, dtype=float), model, runs)


class _SmithRows:
    selection: Selection = "applied"

    def __init__(self, K: Sequence[Sequence[float]], model: LoopModel) -> None:
        self._K, self._omega = K, feedforward(model).tolist()
        self._AB = np.hstack([model.A, model.B]).tolist()
        self._C, self._d_max = model.C.tolist(), model.d_max
        self._x = [0.0] * model.A.shape[0]
        self._past: deque[list[float]] = deque([product(self._C, self._x)], maxlen=64)  # model outputs, newest last
        self._k: int | None = None
        self._u = [0.0] * model.B.shape[1]

    def rows(self, k: int, tau: int, y: Sequence[float], r: Sequence[float]) -> Rows:
        if self._k is not None:
            for _ in range(k - self._k):  # a slot whose packet was lost still passes for the model
                self._x = product(self._AB, [*self._x, *self._u])
                self._past.append(product(self._C, self._x))
        self._k = k
        bias = [a - b for a, b in zip(y, self._past[-1 - min(tau, len(self._past) - 1)])]
        star = product(self._omega, r)
        x, rows = self._x, []
        for _ in range(self._d_max + 1):
            error = [a + b - c for a, b, c in zip(product(self._C, x), bias, r)]
            u = [a + b for a, b in zip(star, product(self._K, error))]
            rows.append(tuple(u))
            x = product(self._AB, [*x, *u])
        self._u = list(rows[0])
        return tuple(rows)


class BatchSmith:
    """The predictor in many runs, each bit for bit what `_SmithRows` computes alone; as a batch of one a slot costs five times.

    Args:
        K: gain, (m, p).
        model: the loop.
        runs: how many.
    """

    selection: Selection = "applied"
    memory: int | None = None

    def __init__(self, K: Matrix, model: LoopModel, runs: int) -> None:
        self._K, self._omega = K.tolist(), feedforward(model).tolist()
        self._AB = np.hstack([model.A, model.B]).tolist()
        self._C, self._d_max = model.C.tolist(), model.d_max
        self._x = np.zeros((model.A.shape[0], runs))
        self._u = np.zeros((model.B.shape[1], runs))
        self._past, self._newest = np.zeros((64, model.C.shape[0], runs)), 0  # a ring of model outputs; those before are 0
        self._held = np.ones(runs, dtype=np.intp)
        self._ran = np.zeros(runs, dtype=np.bool_)

    def rows(self, k: int, known: KnownInBatch) -> Matrix:
        """Return the rows of slot k, (rows, m, runs); see `BatchGainRows.rows`."""
        self._x = np.where(self._ran, product_of_batch(self._AB, (*self._x, *self._u)), self._x)
        self._newest = (self._newest - 1) % len(self._past)
        self._past[self._newest] = y = product_of_batch(self._C, self._x)
        self._held = np.minimum(self._held + self._ran, len(self._past))
        tau, r = known.ages.max(axis=0), known.reference
        self._ran = known.started.copy()
        place = (self._newest + np.minimum(tau, self._held - 1)) % len(self._past)
        bias = known.y - self._past[place, :, np.arange(len(tau))].T
        ref, star = np.asarray(r)[:, None], np.array(product(self._omega, r))[:, None]
        x, rows = self._x, [star + product_of_batch(self._K, y + bias - ref)]
        self._u = np.where(known.started, rows[0], self._u)
        for _ in range(self._d_max):
            x = product_of_batch(self._AB, (*x, *rows[-1]))
            rows.append(star + product_of_batch(self._K, product_of_batch(self._C, x) + bias - ref))
        return np.stack(rows)
