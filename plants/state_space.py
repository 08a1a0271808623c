"""A plant that is given by its matrices, without noise, friction or a sensor's grid."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final

import numpy as np

from plants.errors import FieldError
from plants.parts.exponential import Rows
from plants.parts.linear import LinearRun, Signal, StateSpace
from plants.parts.linear_many import LinearRuns

LETTERS: Final = {"inputs": "u", "outputs": "y", "states": "x"}
_NAME: Final = re.compile(r"[a-z][a-z0-9_]*")


@dataclass(frozen=True, slots=True, kw_only=True)
class LinearPlant:
    """A linear plant: x' = A x + B (u + w), y = C x.

    Args:
        A: n rows of n entries.
        B: n rows of m entries.
        C: p rows of n entries.
        inputs: name and unit of the m inputs; ("u1", "1"), ... if left out.
        outputs: name and unit of the p outputs; ("y1", "1"), ... if left out.
        states: name and unit of the n states; ("x1", "1"), ... if left out.
        initial_state: x at time 0, n entries; zero if left out.

    Raises:
        ValueError: where a shape does not fit, an entry is not finite, or a name is taken twice or not in lower case.

    >>> LinearPlant(A=((-1.0,),), B=((2.0,),), C=((1.0,),)).inputs
    (Signal(name='u1', unit='1'),)
    """

    A: Rows
    B: Rows
    C: Rows
    inputs: tuple[Signal, ...] = ()
    outputs: tuple[Signal, ...] = ()
    states: tuple[Signal, ...] = ()
    initial_state: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        for name, rows in (("A", self.A), ("B", self.B), ("C", self.C)):
            if len({len(row) for row in rows}) != 1:
                raise FieldError(name, "expected rows of one length, and at least one")
        model = self.model()
        n, m, p = model.A.shape[0], model.B.shape[1], model.C.shape[0]
        for field, given, size in (("inputs", self.inputs, m), ("outputs", self.outputs, p), ("states", self.states, n)):
            signals = given or tuple(Signal(f"{LETTERS[field]}{i + 1}", "1") for i in range(size))
            object.__setattr__(self, field, signals)
            names = [signal.name for signal in signals]
            if len(names) != size:
                raise FieldError(field, f"{len(names)} signals, but the matrices have {size}")
            for name in names:
                if not _NAME.fullmatch(name):
                    raise FieldError(field, f"{name!r} is no name; expected lower-case letters, digits and _")
                if names.count(name) > 1:
                    raise FieldError(field, f"{name!r} is taken twice")
        start = self.initial_state or (0.0,) * n
        if len(start) != n or not np.isfinite(start).all():
            raise FieldError("initial_state", f"expected {n} finite numbers")
        object.__setattr__(self, "initial_state", tuple(map(float, start)))

    def model(self) -> StateSpace:
        """Return the matrices."""
        return StateSpace(A=self.A, B=self.B, C=self.C)

    def start(self, rng: np.random.Generator) -> LinearRun:
        """Return the plant at time 0. It draws nothing from ``rng``."""
        return LinearRun(self.model(), self.initial_state)

    def start_many(self, runs: int) -> LinearRuns:
        """Return so many of them at time 0."""
        return LinearRuns(self.model(), self.initial_state, runs)
