"""Chapters 2 to 4: continuous-time semi-Markov jump loops, gains scheduled by mode and sojourn time.

Their systems as data: the matrices per mode, their uncertainty, the delay, the disturbance path.

    dx = (A_i + dA_i) x + Ad_i x(t - tau_i(t)) + (B_i + dB_i) u + E_i w,      z = C_i x,      i = mode of the process.

The rates belong to the process (``design.processes.semi_markov``), not to the system, so that one system can be tried under
several.

References: thesis (2.16), (3.1), (3.23), (4.1).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar, Final

import numpy as np
import numpy.typing as npt

from design.controllers.scheduled_gain import ScheduledGain
from design.errors import FieldError, check_at_least_zero
from design.processes.semi_markov import FaultDetection, SemiMarkov

if TYPE_CHECKING:  # nothing of a solver
    from design.lmi import Lift
    from design.lmi.program import Array


FloatArray = npt.NDArray[np.float64]
ENOUGH: Final = 4.0
"""Other units are taken where they make the largest matrix smaller by this factor."""


def _check(owner: object, shapes: Mapping[str, str], known: Mapping[str, int] | None = None, path: str = "") -> dict[str, int]:
    """Make fields read-only float arrays, and return the sizes of their axes: a letter of a shape has one size in all of them.

    Args:
        owner: whose fields.
        shapes: a letter for every axis of each.
        known: sizes that are known before.
        path: before the field's name in an error.
    """
    sizes = {**(known or {})}
    for name, shape in shapes.items():
        try:
            array = np.array(getattr(owner, name), dtype=float)
        except (TypeError, ValueError):
            raise FieldError(path + name, "is not an array of numbers (do all modes have the same shape?)") from None
        if array.ndim != len(shape):
            raise FieldError(path + name, f"{array.ndim} axes, expected {len(shape)}; got shape {array.shape}")
        for axis, letter in enumerate(shape):
            if array.shape[axis] != (size := sizes.setdefault(letter, array.shape[axis])):
                raise FieldError(path + name, f"shape {array.shape}, expected {size} along axis {axis}")
        if not np.isfinite(array).all():
            where = tuple(int(k) for k in np.argwhere(~np.isfinite(array))[0])
            raise FieldError(f"{path}{name}{list(where)}", f"{array[where]} is not finite")
        array.setflags(write=False)
        object.__setattr__(owner, name, array)
    return sizes


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NormBounded:
    """dA_i = E_i delta FA_i, dB_i = E_i delta FB_i with delta'delta <= I, free in time (2.16).

    Args:
        e: shape (N, n, q).
        fa: shape (N, q', n).
        fb: shape (N, q', m); delta is q x q'.
    """

    e: FloatArray
    fa: FloatArray
    fb: FloatArray
    shapes: ClassVar = {"e": "Nnq", "fa": "Npn", "fb": "Npm"}

    def __post_init__(self) -> None:
        _check(self, self.shapes)

    def scaled(self, scale: float) -> NormBounded:
        """The same uncertainty, ``scale`` times as large."""
        return replace(self, fa=scale * self.fa, fb=scale * self.fb)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class VertexUncertainty:
    """(dA_i, dB_i) anywhere in the convex hull of V pairs, free in time.

    Args:
        da: shape (V, N, n, n).
        db: shape (V, N, n, m).
    """

    da: FloatArray
    db: FloatArray
    shapes: ClassVar = {"da": "VNnn", "db": "VNnm"}

    def __post_init__(self) -> None:
        _check(self, self.shapes)

    def scaled(self, scale: float) -> VertexUncertainty:
        """The same uncertainty, ``scale`` times as large."""
        return replace(self, da=scale * self.da, db=scale * self.db)


Uncertainty = NormBounded | VertexUncertainty


class _Sized:
    """The sizes of a system, read off its matrices."""

    __slots__ = ()
    a: FloatArray
    b: FloatArray

    @property
    def modes(self) -> int:
        """Number of modes N."""
        return int(self.a.shape[0])

    @property
    def states(self) -> int:
        """Number of states n."""
        return int(self.a.shape[1])

    @property
    def inputs(self) -> int:
        """Number of inputs m."""
        return int(self.b.shape[2])

    def check(self, process: SemiMarkov | FaultDetection, gain: ScheduledGain | None = None) -> None:
        """Raise FieldError unless the process, and the gains by what they measure of it, have the sizes of the system."""
        real, of, measured = process.failure if isinstance(process, FaultDetection) else process, self.modes, ""
        if real.modes != self.modes:
            word = "modes" if real is process else "failure modes"
            raise FieldError("process", f"{real.modes} {word}, the system has {self.modes}")
        if isinstance(process, FaultDetection) and gain is not None:
            seen = process.detection[0].modes
            known = {(): 1, ("r",): seen, ("eta", "r"): self.modes * seen}
            if gain.measured not in known:
                raise FieldError("measured", f"{gain.measured!r} is not (), ('r',) or ('eta', 'r')")
            of, measured = known[gain.measured], f" for measured = {gain.measured!r}"
        expected = (of, self.inputs, self.states)
        if gain is not None and (got := (gain.modes, *gain.gain.shape[2:])) != expected:
            raise FieldError("gain", f"(modes, inputs, states) = {got}, expected {expected}{measured}")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JumpSystem(_Sized):
    """Matrices of a jump linear system with N modes, n states, m inputs.

    Args:
        a: shape (N, n, n).
        b: shape (N, n, m).
        c: z = C_i x, shape (N, p, n), optional.
        e: disturbance, shape (N, n, q), optional.
        uncertainty: of A and B, optional.
        sensors: the controller gets S_i x, shape (N, n, n); None: x in every mode.

    Raises:
        ValueError: a matrix has the wrong shape or an entry that is not finite (the message starts with the field).
    """

    a: FloatArray
    b: FloatArray
    c: FloatArray | None = None
    e: FloatArray | None = None
    uncertainty: Uncertainty | None = None
    sensors: FloatArray | None = None

    def __post_init__(self) -> None:
        may = {"c": "Npn", "e": "Nnq", "sensors": "Nnn"}
        given = {name: shape for name, shape in may.items() if getattr(self, name) is not None}
        sizes = _check(self, {"a": "Nnn", "b": "Nnm"} | given)
        if self.uncertainty is not None:
            _check(self.uncertainty, self.uncertainty.shapes, {size: sizes[size] for size in "Nnm"}, "uncertainty.")

    def shown(self, mode: int) -> FloatArray:
        """What the controller gets of x in a mode, S_i, (n, n)."""
        return np.eye(self.states) if self.sensors is None else self.sensors[mode]

    @property
    def vertices(self) -> list[int | None]:
        """The vertices of its uncertainty; one None where it has no vertices."""
        uncertainty = self.uncertainty
        return list(range(uncertainty.da.shape[0])) if isinstance(uncertainty, VertexUncertainty) else [None]

    def at(self, mode: int, vertex: int | None, lift: Lift) -> tuple[Array, Array]:
        """A and B of a mode, at a vertex of the uncertainty where it has them, in floats or in fractions."""
        a, b, uncertainty = lift(self.a[mode]), lift(self.b[mode]), self.uncertainty
        if isinstance(uncertainty, VertexUncertainty) and vertex is not None:
            a, b = a + lift(uncertainty.da[vertex, mode]), b + lift(uncertainty.db[vertex, mode])
        return a, b

    def scaled(self, scale: float) -> JumpSystem:
        """The same nominal system with its uncertainty ``scale`` times as large."""
        return replace(self, uncertainty=None if self.uncertainty is None else self.uncertainty.scaled(scale))

    def at_vertex(self, vertex: int) -> JumpSystem:
        """The certain system at one vertex of its uncertainty (constant, the same in all modes)."""
        if not isinstance(self.uncertainty, VertexUncertainty):
            raise FieldError("uncertainty", "has no vertices")
        da, db = self.uncertainty.da[vertex], self.uncertainty.db[vertex]
        return replace(self, a=self.a + da, b=self.b + db, uncertainty=None)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DelayedJumpSystem(_Sized):
    """A jump linear system with a state delay tau_i(t) <= delay_max_s, d tau_i/dt <= slope_i < 1 (3.1)-(3.2).

    Args:
        a, ad: shape (N, n, n).
        b: shape (N, n, m).
        e: disturbance, shape (N, n, q).
        c: z = C_i x, shape (N, p, n).
        delay_max_s: largest delay (s).
        delay_slopes: bound on the growth of the delay per mode, shape (N,).
    """

    a: FloatArray
    ad: FloatArray
    b: FloatArray
    e: FloatArray
    c: FloatArray
    delay_max_s: float
    delay_slopes: FloatArray

    def __post_init__(self) -> None:
        _check(self, {"a": "Nnn", "ad": "Nnn", "b": "Nnm", "e": "Nnq", "c": "Npn", "delay_slopes": "N"})
        slopes = self.delay_slopes
        if (slopes >= 1).any():
            worst = int(np.argmax(slopes))
            raise FieldError(f"delay_slopes[{worst}]", f"{slopes[worst]:g} is not below 1, as (3.2) demands")
        check_at_least_zero(delay_max_s=self.delay_max_s)


System = JumpSystem | DelayedJumpSystem


def balanced(system: System, gain: ScheduledGain, period_s: float) -> tuple[System, ScheduledGain]:
    """The same loop in units of its states and inputs in which its matrices are of one size: no verdict depends on units.

        x = D x',  u = G u',  diagonal and powers of 2, so that nothing is rounded: the balance of [A, B; K / T, 0] in all modes.

    A loop whose units are good enough stays as it is.

    Args:
        system: matrices; what it says of z and w is left out of account.
        gain: fits the system.
        period_s: T (s).

    Reference: Parlett and Reinsch, Balancing a matrix for calculation of eigenvalues and eigenvectors, Numer. Math. 13 (1969).
    """
    from scipy.linalg import matrix_balance  # who only reads a system needs none of it

    n, m = system.states, system.inputs
    sizes = np.zeros((n + m, n + m))
    sizes[:n, :n], sizes[:n, n:] = np.abs(system.a).max(axis=0), np.abs(system.b).max(axis=0)
    sizes[n:, :n] = np.abs(gain.gain).max(axis=(0, 1)) / period_s
    smaller, (units, _) = matrix_balance(sizes, permute=False, separate=True)
    if np.linalg.norm(sizes) < ENOUGH * np.linalg.norm(smaller):
        return system, gain
    x, u = units[:n], units[n:]
    state, given = x / x[:, None], u / x[:, None]
    gain = replace(gain, gain=gain.gain * (x / u[:, None]))
    if isinstance(system, DelayedJumpSystem):
        return replace(system, a=system.a * state, ad=system.ad * state, b=system.b * given), gain
    free, sensors = system.uncertainty, None if system.sensors is None else system.sensors * state
    if isinstance(free, NormBounded):
        free = replace(free, e=free.e / x[:, None], fa=free.fa * x, fb=free.fb * u)
    elif free is not None:
        free = replace(free, da=free.da * state, db=free.db * given)
    return replace(system, a=system.a * state, b=system.b * given, uncertainty=free, sensors=sensors), gain
