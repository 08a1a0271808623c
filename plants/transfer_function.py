"""A plant that is given by the transfer function from its one input to its one output."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from plants.errors import FieldError
from plants.parts.linear import Signal, StateSpace
from plants.parts.linear_many import LinearRuns
from plants.parts.protocols import PlantRun
from plants.state_space import LinearPlant

INPUT: Final = Signal("u", "1")
OUTPUT: Final = Signal("y", "1")


@dataclass(frozen=True, slots=True, kw_only=True)
class TransferFunction:
    """A linear plant: y(s) = num(s) / den(s) (u(s) + w(s)), realised in controllable canonical form, at rest at time 0.

    Args:
        num: coefficients of the numerator, the highest power of s first; of a lower degree than ``den``.
        den: coefficients of the denominator, the highest power of s first.
        input: name and unit of the input.
        output: name and unit of the output.

    Raises:
        ValueError: where a coefficient is not finite, ``den`` begins with 0, or ``num`` is 0 or not of a lower degree.

    >>> TransferFunction(num=(170.0,), den=(1.0, 20.0, 0.0)).model().A.tolist()
    [[0.0, 1.0], [-0.0, -20.0]]
    """

    num: tuple[float, ...]
    den: tuple[float, ...]
    input: Signal = INPUT
    output: Signal = OUTPUT

    def __post_init__(self) -> None:
        for name, values in (("num", self.num), ("den", self.den)):
            if not values or not np.isfinite(values).all():
                raise FieldError(name, "expected finite coefficients, and at least one")
        if not self.den[0]:
            raise FieldError("den", "begins with 0; expected the coefficient of the highest power of s")
        if not any(self.num):
            raise FieldError("num", "is 0: the input does not reach the output")
        if len(np.trim_zeros(self.num, "f")) >= len(self.den):
            raise FieldError("num", "is not of a lower degree than den; a rig measures y(k) before u(k) exists")
        self._realised()  # what its names and numbers lack is told now

    def _realised(self) -> LinearPlant:
        n = len(self.den) - 1
        den = [a / self.den[0] for a in self.den[1:]]
        num = [b / self.den[0] for b in np.trim_zeros(self.num, "f")]
        shift = [tuple(float(j == i + 1) for j in range(n)) for i in range(n - 1)]
        return LinearPlant(
            A=(*shift, tuple(-a for a in reversed(den))),
            B=tuple((float(i == n - 1),) for i in range(n)),
            C=(tuple(map(float, (*reversed(num), *(0.0,) * (n - len(num))))),),
            inputs=(self.input,),
            outputs=(self.output,),
        )

    @property
    def inputs(self) -> tuple[Signal, ...]:
        """The input."""
        return (self.input,)

    @property
    def outputs(self) -> tuple[Signal, ...]:
        """The output."""
        return (self.output,)

    @property
    def states(self) -> tuple[Signal, ...]:
        """The states of the realisation."""
        return self._realised().states

    def model(self) -> StateSpace:
        """Return the realisation."""
        return self._realised().model()

    def start(self, rng: np.random.Generator) -> PlantRun:
        """Return the plant at time 0. It draws nothing from ``rng``."""
        return self._realised().start(rng)

    def start_batch(self, runs: int) -> LinearRuns | None:
        """Return so many of them at time 0."""
        return self._realised().start_batch(runs)
