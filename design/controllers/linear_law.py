"""A linear controller with a state of its own, u = u* + C xi + D (y - r), xi' = A xi + B (y - r): one row for every delay."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from design.controllers.contract import LoopModel, Rows, RunningController, Selection


class LinearLaw(Struct, frozen=True, kw_only=True, eq=False):
    """Matrices of a linear controller.

    Args:
        A, B, C, D: shapes (c, c), (c, p), (m, c), (m, p); c may be 0.
    """

    A: NDArray[np.float64]
    B: NDArray[np.float64]
    C: NDArray[np.float64]
    D: NDArray[np.float64]

    def one_row(self) -> RowsLaw:
        """Return the same law as one that answers with a row."""
        return RowsLaw(A=self.A, B=self.B, C=self.C[None], D=self.D[None])


class RowsLaw(Struct, frozen=True, kw_only=True, eq=False):
    """Matrices of a linear controller that answers with several rows, v_j = C_j xi + D_j e.

    Args:
        A, B, C, D: shapes (c, c), (c, p), (rows, m, c), (rows, m, p); c may be 0.
    """

    A: NDArray[np.float64]
    B: NDArray[np.float64]
    C: NDArray[np.float64]
    D: NDArray[np.float64]


@runtime_checkable
class LinearFeedback(Protocol):
    """A controller that is linear with a state of its own; over delay chains its loop can be certified."""

    def start(self, model: LoopModel) -> RunningController: ...

    def linear_law(self, model: LoopModel) -> LinearLaw:
        """Return its matrices; every packet has one row, whatever its delay."""


@runtime_checkable
class AgedFeedback(Protocol):
    """A controller that is linear with a state of its own, by matrices for every age of its sample; over known ages certified."""

    def start(self, model: LoopModel) -> RunningController: ...

    def laws_of_ages(self, model: LoopModel, ages: int) -> tuple[RowsLaw, ...]:
        """Return the matrices for samples of the age 0, 1, ..., ages - 1: those that run while no sample is older."""


class AgedRows(Struct, frozen=True, kw_only=True):
    """A linear controller as its matrices of every age say; without a feedforward.

    Args:
        laws: of the age 0, 1, ...; the last for all beyond.
        selection: how the actuator picks a row.
    """

    laws: tuple[RowsLaw, ...]
    selection: Selection

    def start(self, model: LoopModel) -> RunningController:
        return _AgedRun(self.laws, self.selection)


class _AgedRun:
    def __init__(self, laws: tuple[RowsLaw, ...], selection: Selection) -> None:
        self.selection = selection
        self._laws, self._xi = laws, np.zeros(len(laws[0].A))

    def rows(self, k: int, tau: int, y: Sequence[float], r: Sequence[float]) -> Rows:
        law, e = self._laws[min(tau, len(self._laws) - 1)], np.asarray(y, dtype=float)
        found = law.C @ self._xi + law.D @ e
        self._xi = law.A @ self._xi + law.B @ e
        return tuple(tuple(row) for row in found.tolist())
