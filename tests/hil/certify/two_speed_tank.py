"""A foreign plant: one level that rises by itself, faster in its second mode; nothing of ours but the public face."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from plants import JumpModel, JumpRates, Signal, StateSpace, TransitionRates


@dataclass(frozen=True, slots=True, kw_only=True)
class TwoSpeedTank:
    """x' = a_i x + b_i u, the mode i of a Markov process; measured: x and i.

    Args:
        growth: a_1 and a_2 in 1/s.
        effect: b_1 and b_2.
        rate: rate of leaving either mode in 1/s.
    """

    growth: tuple[float, float] = (0.2, 1.0)
    effect: tuple[float, float] = (1.0, 0.8)
    rate: float = 0.5

    inputs: ClassVar[tuple[Signal, ...]] = (Signal("valve", "1"),)
    outputs: ClassVar[tuple[Signal, ...]] = (Signal("level", "m"), Signal("mode", "1"))
    states: ClassVar[tuple[Signal, ...]] = outputs

    def model(self) -> StateSpace:
        return StateSpace(A=[[self.growth[0]]], B=[[self.effect[0]]], C=[[1.0], [0.0]])

    def jump_system(self) -> JumpModel:
        return JumpModel(A=tuple(((a,),) for a in self.growth), B=tuple(((b,),) for b in self.effect))

    def jump_process(self) -> JumpRates:
        r = self.rate
        return JumpRates(rates=TransitionRates(nodes_s=(0.0,), rates=(((-r, r), (r, -r)),)))

    def start(self, rng: np.random.Generator) -> TankRun:
        return TankRun(self, rng)


class TankRun:
    def __init__(self, tank: TwoSpeedTank, rng: np.random.Generator) -> None:
        self._tank, self._rng = tank, rng
        self._x, self._mode, self._u = 1.0, 0, 0.0
        self._left_ns = self._stay()

    def _stay(self) -> int:
        return max(1, round(1e9 * float(self._rng.exponential(1.0 / self._tank.rate))))

    def advance(self, dt_ns: int, u: Sequence[float], w: Sequence[float] = ()) -> None:
        self._u = float(u[0])
        v = self._u + (w[0] if w else 0.0)
        while dt_ns > 0:
            step_ns = min(dt_ns, self._left_ns)
            a, b = self._tank.growth[self._mode], self._tank.effect[self._mode]
            h = step_ns * 1e-9
            self._x = self._x * math.exp(a * h) + b * v * math.expm1(a * h) / a
            dt_ns, self._left_ns = dt_ns - step_ns, self._left_ns - step_ns
            if self._left_ns == 0:
                self._mode, self._left_ns = (self._mode + 1) % len(self._tank.growth), self._stay()

    def measure(self) -> tuple[float, ...]:
        return (self._x, float(self._mode + 1))

    @property
    def state(self) -> tuple[float, ...]:
        return self.measure()

    @property
    def applied(self) -> tuple[float, ...]:
        return (self._u,)
