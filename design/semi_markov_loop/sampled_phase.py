"""Lyapunov functions over the phase of a sample period: of sampled loops whose plant jumps and is uncertain.

The matrices may vary freely in time:

    dx/dt = (A_i + dA_i) x + (B_i + dB_i) v_-D,    v held,    i = mode

With z = (x, v_0, ..., v_-D), phase s in [0, T] of the sample period, age h of the mode, and section b of the gain that the last
sample found,

    V = z' P_ib(h, s) z,    P_ib(h, s) = X_ib(h) + Y_ib(s),    Y_ib(0) = 0,    both piecewise linear,

and V = z' (U_il + W_il(s)) z from a jump, into mode i, to the next sample: l is the mode that the last sample found. With Az_i
the flow of z, at both ends of every cell of h and of s, at every corner of the rates' bounds over the cell and at every vertex of
the uncertainty (all are affine in each),

    dX_ib/dh + dY_ib/ds + Az_i' P_ib + P_ib Az_i + sum_j lambda_ij (U_ji + W_ji(s) - P_ib)  <  -m I,
    dW_il/ds + Az_i' (U_il + W_il) + (U_il + W_il) Az_i + sum_j lambda_ij (U_jl + W_jl - U_il - W_il)  <  -m I.

A norm-bounded uncertainty adds [e F'F, P E; E'P, -e I], F = (F_A, F_B). A sample takes xi = (x, v_0, ..., v_-(D-1)) to z:

    P_ib(h, T) >= [xi -> z]' P_ic(h, 0) [xi -> z],        c: the sections that the next sample may find,
    U_il + W_il(T) >= [xi -> z]' P_ic(h, 0) [xi -> z],    h in [0, T]; where i = l, the mode was left and entered again unseen,
                                                          and c is any section; else it is that of a mode just found.

So E int |z|^2 is finite.

Reference: thesis (2.16), sampled; `design.semi_markov_loop.sampled_inner_delay` has those of a delay inside the plant.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from design.lmi import as_float
from design.lmi.program import Array, LmiProgram, LmiSolution, symmetric_blocks, symmetric_part, transpose
from design.semi_markov_loop import FloatArray, NormBounded
from design.semi_markov_loop.period_moments import TooLarge, factors, held_flow, svec_size
from design.semi_markov_loop.sojourn_renewal import SampledLoop, rates_by_age

CONDITION = 1e4
"""Largest eigenvalue of P that is searched."""
UNKNOWNS = 2500
"""Most unknowns of one search, which takes a few seconds."""
SHAPES = ((4, 1), (4, 4), (12, 4), (4, 16))
"""Into how many cells the ages are cut over which the rates of a mode change, and into how many a period; the quickest first."""


def first_that_holds(tried: Iterable[tuple[int, Callable[[], LmiProgram]]], most: int, loop: SampledLoop) -> LmiSolution:
    """The solution of the first program that holds, or of the last, of those with at most so many unknowns; TooLarge if none."""
    found, least = None, math.inf
    for unknowns, program in tried:
        least = min(least, unknowns)
        if unknowns <= most:
            found = program().solve()
            if found.holds:
                break
    if found is None:
        size = f"{loop.system.modes} modes and {loop.size + loop.system.inputs} states with delayed inputs"
        raise TooLarge(f"{size}: {least} unknowns, at most {most}")
    return found


def corners_of(targets: Sequence[int], low: FloatArray, high: FloatArray) -> list[tuple[float, ...]]:
    """Every corner of the bounds of the rates to these modes."""
    return list(itertools.product(*(sorted({float(low[j]), float(high[j])}) for j in targets)))


def add_bounded(program: LmiProgram, name: str, size: int) -> None:
    """Add a symmetric unknown between 0 and ``CONDITION``."""
    program.symmetric(name, size)
    program.require(f"{name} >= 0", lambda p: -p, name)
    program.require(f"{name} bounded", lambda p: p - CONDITION * np.eye(p.shape[-1]), name, strict=False)


def uncertain_decrease(loop: SampledLoop) -> LmiSolution:
    """Search a Lyapunov function, from the smallest program to the largest; the first that holds is returned, or the last.

    Raises:
        ValueError: rates without a finite bound.
        TooLarge: even the smallest program has more unknowns than ``UNKNOWNS``.
    """
    tried = (UncertainProgram(loop, *shape) for shape in SHAPES)
    return first_that_holds(((each.unknowns, each.built) for each in tried), UNKNOWNS, loop)


class UncertainProgram:
    """The inequalities with the ages of every mode, and a period, cut into so many cells."""

    def __init__(self, loop: SampledLoop, cells: int, parts: int) -> None:
        self.loop, self.size, self.parts = loop, loop.size + loop.system.inputs, parts
        system, T = loop.system, loop.period_s
        settled = [each.end * T for each in (rates_by_age(loop.process, i, T) for i in range(system.modes))]
        self.nodes = [np.linspace(0.0, end, cells + 1) if end > T else np.zeros(1) for end in settled]
        self.keep = np.eye(loop.size, self.size)  # the oldest input has acted and is dropped
        self.program, self.flows = LmiProgram(reach=CONDITION), self._flows()
        sections = [(i, b) for i in range(system.modes) for b in range(loop.gain.starts_s.shape[1])]
        pairs = list(itertools.product(range(system.modes), repeat=2))
        count = sum(self._last(i, b) + 1 + parts for i, b in sections) + (1 + parts) * len(pairs)
        self.unknowns = count * svec_size(self.size)
        self.bound = system.uncertainty if isinstance(system.uncertainty, NormBounded) else None
        self._sections, self._pairs = sections, pairs

    def built(self) -> LmiProgram:
        """The program with its inequalities."""
        sections, pairs = self._sections, self._pairs
        for i, b in sections:
            own = [f"X[{i},{b},{c}]" for c in range(self._last(i, b) + 1)]
            self._add(f"Y[{i},{b}]", *own)
        for i, l in pairs:
            self._add(f"W[{i},{l}]", f"U[{i},{l}]")
        if self.bound is not None:
            self.program.matrix("e", 1, 1)
        for i, b in sections:
            self._of_section(i, b)
        for i, l in pairs:
            self._unseen(i, l)
        return self.program

    def _add(self, phase: str, *names: str) -> None:
        """P = X + Y(s), between 0 and ``CONDITION`` at the nodes of age and phase; the unknown is Y / T."""
        T = self.loop.period_s
        for k in range(1, self.parts + 1):
            self.program.symmetric(f"{phase}{k}", self.size)
        for name in names:
            add_bounded(self.program, name, self.size)
            for k in range(1, self.parts + 1):
                self.program.require(f"{name} + {phase}{k} >= 0", lambda x, y: -(x + T * y), name, f"{phase}{k}")

    def _flows(self) -> FloatArray:
        """The generators of z by mode, one for every vertex of the uncertainty: (N, V, size, size)."""
        system, at = self.loop.system, range(self.loop.system.modes)
        return np.array([[held_flow(*system.at(i, v, as_float), self.size) for v in system.vertices] for i in at])

    def _last(self, mode: int, section: int) -> int:
        """The last node of the age that a section has: what lies beyond it comes later, or the rates are constant there."""
        starts, nodes = self.loop.gain.starts_s[mode], self.nodes[mode]
        if section + 1 == starts.size:
            return len(nodes) - 1
        until = float(starts[section + 1]) + 2.0 * self.loop.period_s  # the sample that finds the next one lies up to T later
        return min(int(np.searchsorted(nodes, until)), len(nodes) - 1)

    def _of_section(self, i: int, b: int) -> None:
        loop, nodes, last = self.loop, self.nodes[i], self._last(i, b)
        starts, phase = loop.gain.starts_s[i], f"Y[{i},{b}]"
        for c in range(last + 1):
            at, end = nodes[c], c == len(nodes) - 1
            if not end and c == last:
                break  # an age that this section does not reach
            low, high = loop.process.bounds(i, at, math.inf if end else nodes[c + 1])
            own = [f"X[{i},{b},{c}]"] if end else [f"X[{i},{b},{c}]", f"X[{i},{b},{c + 1}]"]
            self._falls(i, i, own, phase, low, high, 0.0 if end else nodes[c + 1] - at)
        follows = [b]
        while follows[-1] + 1 < starts.size and starts[follows[-1] + 1] < starts[min(b + 1, starts.size - 1)] + loop.period_s:
            follows.append(follows[-1] + 1)
        for c, section in itertools.product(range(last + 1), follows):
            self._sampled(i, section, c, f"X[{i},{b},{c}]", phase)

    def _unseen(self, i: int, l: int) -> None:
        loop = self.loop
        low, high = loop.process.bounds(i, 0.0, loop.period_s)
        own, phase = f"U[{i},{l}]", f"W[{i},{l}]"
        self._falls(i, l, [own], phase, low, high, 0.0)
        starts = loop.gain.starts_s[i]
        first = int(np.searchsorted(starts, loop.tau * loop.period_s, side="right")) - 1
        for section in range(first, starts.size if i == l else first + 1):
            for c in range(min(int(np.searchsorted(self.nodes[i], loop.period_s)) + 1, len(self.nodes[i]))):
                self._sampled(i, section, c, own, phase)

    def _sampled(self, i: int, section: int, node: int, before: str, phase: str) -> None:
        """P(T) >= [xi -> z]' X [xi -> z], where X has that age; of a gain that is linear in the section, at both of its ends."""
        loop, T = self.loop, self.loop.period_s
        gains, last = loop.gain.gain[i], min(section + 1, loop.gain.gain.shape[1] - 1)
        for K in (gains[section],) if loop.gain.schedule == "hold" or last == section else (gains[section], gains[last]):
            maps = loop.sampled_at(K) @ self.keep

            def rise(old: Array, end: Array, new: Array, sampled: FloatArray = maps) -> Array:
                return np.asarray(sampled.T @ new @ sampled - old - T * end)

            after = f"X[{i},{section},{min(node, self._last(i, section))}]"
            self.program.require(f"sample: {before} to {after}", rise, before, f"{phase}{self.parts}", after, strict=False)

    def _falls(self, i: int, seen: int, own: list[str], phase: str, low: FloatArray, high: FloatArray, cell_s: float) -> None:
        """V falls along the flow of mode i, at both ends of a cell of the age and of every part of the period."""
        targets = [j for j in range(self.loop.system.modes) if j != i and high[j] > 0]
        corners = corners_of(targets, low, high)
        bounded = [] if self.bound is None else ["e"]
        T, parts = self.loop.period_s, self.parts
        for part, right in itertools.product(range(parts), (0, 1)):
            moves = [f"{phase}{k}" for k in (part, part + 1) if k]
            at = part + right
            landing = [name for j in targets for name in (f"U[{j},{seen}]", *([f"W[{j},{seen}]{at}"] if at else []))]
            for end, rates, flow in itertools.product(range(len(own)), corners, self.flows[i]):

                def change(
                    *matrices: Array, end: int = end, right: int = right, rates: tuple[float, ...] = rates,
                    flow: FloatArray = flow, first: bool = part == 0, at: int = at,
                ) -> Array:  # fmt: skip
                    ages, rest = matrices[: len(own)], list(matrices[len(own) :])
                    old = None if first else rest.pop(0)
                    new = rest.pop(0)
                    here = ages[end] + (T * new if right else 0.0 if old is None else T * old)
                    value = symmetric_part(here @ flow) + parts * (new if old is None else new - old)
                    if len(own) == 2:
                        value = value + (ages[1] - ages[0]) / cell_s
                    for rate in rates:
                        value = value + rate * (rest.pop(0) + (T * rest.pop(0) if at else 0.0) - here)
                    return np.asarray(value) if self.bound is None else self._with_bound(self.bound, i, value, here, rest.pop(0))

                name = f"{own[end]} at {at}/{parts} of the period falls at rates {rates}"
                self.program.require(name, change, *own, *moves, *landing, *bounded)

    def _with_bound(self, bound: NormBounded, i: int, value: Array, here: Array, weight: Array) -> Array:
        """Beside a norm-bounded uncertainty: 2 z'P E d F z <= z'P E E'P z / e + e z'F'F z."""
        left, right = factors(bound, i, self.size)
        return symmetric_blocks([[value + weight * (right.T @ right)], [transpose(here @ left), -weight * np.eye(left.shape[1])]])
