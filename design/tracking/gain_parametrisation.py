"""The gains that a design may choose: which information they may depend on, which are equal, how large they may be.

Information pattern        selection    free gains
constant                   constant     one for all
tau                        constant     one per tau
previous, generated,       the same     one per (tau, row)
applied, both
total                      applied      one per total age tau + d

A bound G on every entry is kept by K = G sin(v): smooth, and the bound can be reached.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from design.errors import FieldError
from design.networked_loop.closed_loop import LoopStructure
from design.processes.delay_chain import Array, DelayChain, Index

Information = Literal["constant", "tau", "previous", "generated", "applied", "both", "total"]
INFORMATION: tuple[str, ...] = get_args(Information)


def selection_of(information: str) -> str:
    """Row rule by which the loop runs gains of an information pattern.

    Raises:
        ValueError: unknown pattern.
    """
    if information not in INFORMATION:
        raise FieldError("information", f"{information!r}, expected one of {', '.join(INFORMATION)}")
    return {"tau": "constant", "total": "applied"}.get(information, information)


COARSER: dict[str, str] = {
    "tau": "constant", "total": "constant", "previous": "tau", "generated": "tau", "applied": "tau", "both": "applied",
}  # fmt: skip
"""For each pattern one whose gains are a special case of its own: its optimum is a start that cannot lose."""


def embed(gains: Array, finer_rows: int) -> Array:
    """Gains of a coarser pattern (see `COARSER`) in the shape of the finer one, the loop being the same."""
    return np.asarray(np.tile(gains, (1, finer_rows // gains.shape[1], 1, 1)))


@dataclass(frozen=True, slots=True)
class GainParametrisation:
    """Coordinates v of the gains K: equal gains share coordinates, gains without effect are zero.

    Fields: `shape` of K, (sc labels, rows, m, py); `block` (sc labels, rows), index of the free gain, -1 where a
    gain has no effect; `bound` on every |entry| of K, or None.
    """

    shape: tuple[int, int, int, int]
    block: Index
    bound: float | None

    @property
    def size(self) -> int:
        """Number of coordinates."""
        return (int(self.block.max()) + 1) * self.shape[2] * self.shape[3]

    def gains(self, v: Array) -> Array:
        """K of coordinates v."""
        free = v.reshape(-1, *self.shape[2:])
        if self.bound is not None:
            free = self.bound * np.sin(free)
        gains = free[self.block]
        gains[self.block < 0] = 0.0
        return np.asarray(gains)

    def gradient(self, v: Array, gradient: Array) -> Array:
        """Derivative with respect to v from the one with respect to K."""
        total = np.zeros((int(self.block.max()) + 1, *self.shape[2:]))
        used = self.block >= 0
        np.add.at(total, self.block[used], gradient[used])
        flat = total.ravel()
        return flat if self.bound is None else flat * self.bound * np.cos(v)

    def curvature(self, v: Array, curvature: Array) -> Array:
        """Second derivative with respect to v from the one with respect to the free gains, where K bends less than the norm."""
        if self.bound is None:
            return curvature
        slope = self.bound * np.cos(v)
        return np.asarray(slope[:, None] * curvature * slope)

    def coordinates(self, gains: npt.ArrayLike) -> Array:
        """Coordinates of the nearest K in the space (means of gains that must be equal, clipped to the bound)."""
        K = np.asarray(gains, dtype=np.float64)
        blocks = int(self.block.max()) + 1
        mean = np.stack([K[self.block == b].mean(axis=0) for b in range(blocks)])
        if self.bound is not None:
            mean = np.arcsin(np.clip(mean / self.bound, -0.99, 0.99))
        return np.asarray(mean.ravel())


def gain_parametrisation(
    structure: LoopStructure, information: str, sc: DelayChain, ca: DelayChain, bound: float | None = None
) -> GainParametrisation:
    """The free gains of an information pattern on a loop structure made with `selection_of(information)`.

    Raises:
        ValueError: unknown pattern, or a bound that is not positive.
    """
    if bound is not None and not (np.isfinite(bound) and bound > 0):
        raise FieldError("gain_bound", f"{bound:g}, expected a finite number > 0")
    used = structure.used
    if information == "constant":
        key = np.zeros(used.shape, dtype=np.int64)
    elif information == "total":
        key = sc.label_delay[:, None] + ca.label_delay[None, :]
    else:
        key = np.arange(used.size).reshape(used.shape)
    block = np.full(used.shape, -1, dtype=np.int64)
    block[used] = np.unique(key[used], return_inverse=True)[1]
    return GainParametrisation(structure.gain_shape, block, bound)
