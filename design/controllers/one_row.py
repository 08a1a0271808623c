"""Controllers that know no network, with one row for every delay: a gain, output feedback with a state of its own, an input."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from design.controllers.contract import LoopModel, Rows, RunningController, Selection
from design.controllers.exact_products import dot
from design.controllers.gain_rows import feedforward
from design.controllers.linear_law import LinearLaw
from design.controllers.send_all import TableAlone
from design.errors import FieldError

Matrix = tuple[tuple[float, ...], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Local(TableAlone):
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Constant:
    """The same input in every slot and for every row: for tests and for open-loop experiments.

    Args:
        value: tuple of float, length m. Input, in the plant's input unit.
    """

    value: tuple[float, ...] = (0.0,)

    def start(self, model: LoopModel) -> RunningController:
        if len(self.value) != model.B.shape[1]:
            raise FieldError("value", f"length {len(self.value)}, expected {model.B.shape[1]}: one for each input")
        return _ConstantRows(self.value)


class _ConstantRows:
    selection: Selection = "constant"

    def __init__(self, value: tuple[float, ...]) -> None:
        self._rows = (tuple(map(float, value)),)

    def rows(self, k: int, tau: int, y: Sequence[float], r: Sequence[float]) -> Rows:
        return self._rows


@dataclass(frozen=True, slots=True, kw_only=True)
class OutputFeedback:
    """Dynamic output feedback of any origin, such as LQG: xi(k+1) = A xi + B e, u = u* + C xi + D e, e = y - r.

    It takes the newest sample as if it were of this slot: a local design knows no network.

    Args:
        A: nested tuple [c][c].
        B: nested tuple [c][p].
        C: nested tuple [m][c].
        D: nested tuple [m][p]. Input unit per output unit.
    """

    kind: ClassVar[str] = "output-feedback"

    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix

    def linear_law(self, model: LoopModel) -> LinearLaw:
        c, m, p = len(self.A), model.B.shape[1], model.C.shape[0]
        found: dict[str, NDArray[np.float64]] = {}
        for name, value, shape in (("A", self.A, (c, c)), ("B", self.B, (c, p)), ("C", self.C, (m, c)), ("D", self.D, (m, p))):
            try:
                matrix = np.asarray(value, dtype=float)
            except ValueError:
                matrix = np.full((0,), np.nan)
            if matrix.shape != shape and not (matrix.size == 0 and 0 in shape):
                raise FieldError(name, f"shape {list(matrix.shape)} does not fit; expected {list(shape)} for this plant")
            if not np.isfinite(matrix).all():
                raise FieldError(name, "not finite")
            found[name] = matrix.reshape(shape)
        return LinearLaw(**found)

    def start(self, model: LoopModel) -> RunningController:
        return _LinearRows(self.linear_law(model), model)


class _LinearRows:
    selection: Selection = "constant"

    def __init__(self, law: LinearLaw, model: LoopModel) -> None:
        self._omega = feedforward(model).tolist()
        self._state_rows = np.hstack([law.A, law.B]).tolist()
        self._input_rows = np.hstack([law.C, law.D]).tolist()
        self._xi = [0.0] * law.A.shape[0]

    def rows(self, k: int, tau: int, y: Sequence[float], r: Sequence[float]) -> Rows:
        known = self._xi + [a - b for a, b in zip(y, r)]
        u = tuple([dot(star, r) + dot(row, known) for star, row in zip(self._omega, self._input_rows)])
        self._xi = [dot(row, known) for row in self._state_rows]
        return (u,)
