"""State-feedback gains scheduled by mode and sojourn time: what a controller of Chapters 2 to 4 carries into its loop.

    u = K(i, h) x,

with K(i, .) either held on sections [starts_s[i, s], starts_s[i, s+1]) or linear between the nodes starts_s[i, s].

Needs numpy only, so that the process that keeps time can load it. References: thesis (2.17), (3.6), (4.3).
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from design.errors import FieldError

FloatArray = npt.NDArray[np.float64]
Schedule = Literal["hold", "linear"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ScheduledGain:
    """Gains over mode and sojourn time.

    Args:
        gain: K, shape (modes, sections, inputs m, states n).
        starts_s: where each section (``hold``) or node (``linear``) lies on the sojourn clock (s), shape (modes, sections);
            the first is 0. After the last one the gain stays as it is.
        schedule: ``hold`` or ``linear``.
        measured: what the mode index means, e.g. ``("r",)``, or ``("eta", "r")`` for the index eta * N_r + r.

    >>> gain = ScheduledGain(gain=np.array([[[[1.0]], [[3.0]]]]), starts_s=np.array([[0.0, 2.0]]), schedule="linear")
    >>> gain.at(0, 1.0).tolist(), gain.norm
    ([[2.0]], 3.0)
    """

    gain: FloatArray
    starts_s: FloatArray
    schedule: Schedule = "hold"
    measured: tuple[str, ...] = ("r",)

    def __post_init__(self) -> None:
        gain, starts = np.array(self.gain, dtype=float), np.array(self.starts_s, dtype=float)
        if gain.ndim != 4 or 0 in gain.shape:
            raise FieldError("gain", f"shape {gain.shape}, expected (modes, sections, inputs, states)")
        if not np.isfinite(gain).all():
            raise FieldError("gain", f"entry {tuple(int(k) for k in np.argwhere(~np.isfinite(gain))[0])} is not finite")
        if starts.shape != gain.shape[:2]:
            raise FieldError("starts_s", f"shape {starts.shape}, expected {gain.shape[:2]} as the gains")
        if not np.isfinite(starts).all() or (starts[:, 0] != 0.0).any() or (np.diff(starts, axis=1) <= 0).any():
            raise FieldError("starts_s", "expected finite increasing sojourn times that start at 0 in every mode")
        if self.schedule not in get_args(Schedule):
            raise FieldError("schedule", f"{self.schedule!r} is not one of {get_args(Schedule)}")
        gain.setflags(write=False)
        starts.setflags(write=False)
        object.__setattr__(self, "gain", gain)
        object.__setattr__(self, "starts_s", starts)

    @property
    def modes(self) -> int:
        """Number of modes that the controller distinguishes."""
        return int(self.gain.shape[0])

    @property
    def norm(self) -> float:
        """Largest spectral norm of any gain; interpolation cannot exceed it (the norm is convex)."""
        return float(np.linalg.norm(self.gain, ord=2, axis=(-2, -1)).max())

    def at(self, mode: int, h: float) -> FloatArray:
        """K(mode, h), shape (m, n), at sojourn time h (s)."""
        starts = self.starts_s[mode]
        section = max(int(np.searchsorted(starts, h, side="right")) - 1, 0)
        if self.schedule == "hold" or section + 1 == starts.size:
            return np.asarray(self.gain[mode, section])
        part = (h - starts[section]) / (starts[section + 1] - starts[section])
        return np.asarray((1.0 - part) * self.gain[mode, section] + part * self.gain[mode, section + 1])

    def rows(self) -> Callable[[int, float], list[list[float]]]:
        """Return what gives K(mode, h) as m rows of n numbers, for a loop: `at`, without an array where a gain is held."""
        gains, starts = self.gain.tolist(), self.starts_s.tolist()
        held = self.schedule == "hold"

        def rows_at(mode: int, h: float) -> list[list[float]]:
            own = starts[mode]
            section = max(bisect_right(own, h) - 1, 0)
            if held or section + 1 == len(own):
                found: list[list[float]] = gains[mode][section]
                return found
            between: list[list[float]] = self.at(mode, h).tolist()
            return between

        return rows_at


def constant_gain(gain: npt.ArrayLike) -> ScheduledGain:
    """One gain per mode, whatever the sojourn time: ``gain`` of shape (modes, m, n)."""
    array = np.asarray(gain, dtype=float)
    if array.ndim != 3:
        raise FieldError("gain", f"shape {array.shape}, expected (modes, inputs, states)")
    return ScheduledGain(gain=array[:, None], starts_s=np.zeros((array.shape[0], 1)))


def tabulated(
    tables: Sequence[Sequence[tuple[float, FloatArray]]], schedule: Schedule = "hold", measured: tuple[str, ...] = ("r",)
) -> ScheduledGain:
    """Return the gains of tables of (start of a section, gain), one for each mode; one that is shorter repeats its last gain."""
    longest = max(map(len, tables))
    full = [[*row, *((row[-1][0] + 1.0 + k, row[-1][1]) for k in range(longest - len(row)))] for row in tables]
    starts, gains = ([[entry[part] for entry in row] for row in full] for part in (0, 1))
    return ScheduledGain(gain=np.array(gains), starts_s=np.array(starts), schedule=schedule, measured=measured)
