"""The second moments of a sampled loop with ages finer than a period, between two sides that close as the cells become small.

    state at a sample: the mode i that is seen, the count c of samples since it was first seen, and the true age in cells
                       [a D, (a + 1) D), D = T / G; the last cell is [M D, inf)

Over a period the command is held and the mode moves in G steps of D. In a step the paths without a jump grow one cell older;
those that jump are new in their mode. All rates are taken within their bounds over a step, so that the map is larger
(``upper``) or smaller. `sojourn_renewal` follows ages in whole periods: where rates change within a period its sides are apart.

Positive maps L, and any positive X (Collatz and Wielandt): L X <= t X bounds the radius by t, L X >= t X from below.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np

from design.semi_markov_loop import FloatArray
from design.semi_markov_loop.period_moments import congruence, growth_bound, period_moments, smat, svec, svec_size
from design.semi_markov_loop.sojourn_renewal import SampledLoop, rates_by_age

FINEST = 32
"""Most cells in a period."""
WORK = 4e9
"""Most multiplications for one side at one number of cells."""
ROUNDS = 400
"""Periods over which a side is followed."""
SETTLED, PATIENCE = 0.01, 32
"""Share of the distance to 1 below which a growth counts as settled; periods in which what is summed up has to fall."""
MARGIN, ROUNDING = 1e-6, 1e-12
"""What a growth must differ from 1 by; what rounding leaves of moments of size 1."""


class _Side:
    """One side of the map of a period, on moments (states at a sample, cells, p).

    Args:
        loop: the loop.
        reached: modes that can be reached, counted from 0.
        parts: G, cells in a period.
        upper: whether the map is larger than the true one, or smaller.
    """

    def __init__(self, loop: SampledLoop, reached: Sequence[int], parts: int, *, upper: bool) -> None:
        modes, n, m = loop.system.modes, loop.size, loop.system.inputs
        step, self._parts = loop.period_s / parts, parts
        ages = [rates_by_age(loop.process, i, step) for i in range(modes)]
        self._cells = max(each.end for each in ages) + 1
        self.seen = [(i, c) for i in reached for c in range(loop.last_count(i) + 1)]
        q = svec_size(n + m)
        self.work = float(len(self.seen) * modes * self._cells * q * q * parts)
        self.p = svec_size(n)
        self._loop, self._ages, self._upper, self._step = loop, ages, upper, step

    def prepare(self) -> None:
        """Compute the maps of one step."""
        loop, upper, modes = self._loop, self._upper, self._loop.system.modes
        fresh = [each.over(0, 0) for each in self._ages]
        maps = period_moments(loop.system, fresh, self._step, loop.delay, upper, held=True)
        q, nodes = maps.still.shape[-1], len(maps.nodes_s)
        self._still = np.ascontiguousarray(np.swapaxes(maps.still, 1, 2))
        self._jumped = np.transpose(maps.jumped, (0, 5, 1, 3, 2, 4)).reshape(-1, modes * q)  # from (l, q, j, g) to (k, p)
        self._stays, leaves = np.zeros((modes, self._cells)), np.zeros((modes, self._cells, modes, nodes))
        for i, each in enumerate(self._ages):
            for a in range(self._cells):
                box = each.over(a, a + 1)
                leave = box.leave(upper)
                self._stays[i, a] = math.exp(-leave * self._step)
                leaves[i, a] = np.multiply.outer(box.jump(upper), maps.weights_s * np.exp(-leave * maps.nodes_s))
        self._leaves = leaves.reshape(modes, self._cells, -1)
        self._lift = np.array([congruence(loop.sampled(i, c)) for i, c in self.seen])
        size, m = loop.size + loop.system.inputs, loop.system.inputs
        self._drop = congruence(np.eye(size)[: size - m])
        place = {state: s for s, state in enumerate(self.seen)}
        self._own = np.array([i for i, _ in self.seen])
        self._later = np.array([
            [place[i, min(c + 1, loop.last_count(i))] if l == i else place.get((l, 0), 0) for l in range(modes)]
            for i, c in self.seen
        ])  # fmt: skip

    def unit(self) -> FloatArray:
        """The unit matrix in every state and cell: it exceeds a share of every other moment."""
        one = svec(np.eye(self._loop.size))
        return np.broadcast_to(one, (len(self.seen), self._cells, self.p)).copy()

    def after(self, X: FloatArray) -> FloatArray:
        """The moments at the next sample."""
        modes, count = self._loop.system.modes, len(self.seen)
        Z = np.zeros((count, modes, self._cells, self._lift.shape[1]))
        Z[np.arange(count), self._own] = X @ np.swapaxes(self._lift, 1, 2)
        for _ in range(self._parts):
            stay = self._stays[:, :, None] * (Z @ self._still)
            leaving = np.swapaxes(Z, 2, 3) @ self._leaves  # (states, modes, q, next and nodes)
            moved = np.zeros_like(Z)
            moved[:, :, 1:] = stay[:, :, :-1]
            moved[:, :, -1] += stay[:, :, -1]
            moved[:, :, 0] += (leaving.reshape(count, -1) @ self._jumped).reshape(count, modes, -1)
            Z = moved
        out = np.zeros_like(X)
        np.add.at(out, self._later, Z @ self._drop.T)
        return out


class Refined(NamedTuple):
    """What cells fine enough decide: the state, a bound of the growth of the second moments per period, cells in a period."""

    state: Literal["certified", "refused"]
    growth: float
    parts: int


def refined(loop: SampledLoop, modes: Sequence[int]) -> Refined | None:
    """Return what cells decide that become finer until they do; None where nothing is decided within the budget.

    Args:
        loop: the loop, its system without uncertainty.
        modes: those that can be reached, counted from 0.
    """
    parts = 2
    while parts <= FINEST:
        side = _Side(loop, modes, parts, upper=True)
        if side.work * ROUNDS > WORK:
            return None
        side.prepare()
        growth, _ = _settled(side)
        proved = _contracts(side, growth) if growth < 1.0 - MARGIN else None
        if proved is not None:
            return Refined("certified", proved, parts)
        side = _Side(loop, modes, parts, upper=False)
        side.prepare()
        larger, X = _settled(side)
        if larger > 1.0 + MARGIN and _grows(side, X, 0.5 * (1.0 + larger)):
            return Refined("refused", 0.5 * (1.0 + larger), parts)
        parts *= 2
    return None


def _settled(side: _Side) -> tuple[float, FloatArray]:
    """The growth per period of moments that are followed until it settles, and these moments, of size 1: no proof."""
    X, growth = side.unit(), math.inf
    for k in range(ROUNDS):
        X = side.after(X)
        largest = _largest(X)
        if largest == 0.0:
            return 0.0, X
        X, before, growth = X / largest, growth, largest
        if k > 8 and abs(growth - before) <= max(SETTLED * abs(1.0 - growth), 1e-8):
            break
    return growth, X


def _contracts(side: _Side, growth: float) -> float | None:
    """A bound below 1 of the growth per period: L W <= t W with W = sum_k t^-k L^k I + a share of the last; None if none.

    L W = t (W - I) + what the last adds, which the share of the last takes up where the growth has settled.
    """
    bound = 0.5 * (1.0 + growth)
    last = side.unit()
    W, sizes = last.copy(), [_largest(last)]
    for k in range(ROUNDS):
        last = side.after(last) / bound
        W += last
        sizes.append(_largest(last))
        if sizes[-1] < 1e-3:
            break
        if k > PATIENCE and sizes[-1] > sizes[-PATIENCE]:
            return None  # it grows by more than the bound: the growth had not settled
    W += 4.0 * bound / (bound - growth) * last
    t = growth_bound(W, side.after(W))
    return t if t < 1.0 - MARGIN else None


def _grows(side: _Side, X: FloatArray, growth: float) -> bool:
    """Whether L X >= t X, to rounding of moments of size 1."""
    rest = smat(side.after(X) - growth * X)
    return float(np.linalg.eigvalsh(rest)[..., 0].min()) >= -ROUNDING


def _largest(X: FloatArray) -> float:
    """The largest trace: at least the largest eigenvalue, and a sum instead of one search for each cell."""
    n = round((math.sqrt(8 * X.shape[-1] + 1) - 1) / 2)
    return float((X @ svec(np.eye(n))).max())
