"""Robust state feedback for semi-Markov jump systems (Chapter 2): gains scheduled by mode and sojourn time.

With X = P^-1 and Y = K X the decrease condition becomes linear: for every cell, rate vertex and uncertainty,

    [ A X + B Y + (.)' - dX/dh + (alpha - sum_j lambda_ij) X + eps E E'     *         *     ]
    [ F_A X + F_B Y                                                     -eps I       0     ]  < 0,    K = Y X^-1
    [ sqrt(lambda_ij) X                                                    0      -X_j(0)  ]

- ``pwl``: X, Y and eps linear between nodes; K(h) = Y(h) X(h)^-1 is tabulated for the controller.
- ``pwc``: constant per section, X_{i,m+1} >= X_{i,m}.

A bound on the gain norm is part of every problem, [[k^2 I, Y], [Y', X]] >= 0 with X >= I: without one the gains grow without
end. The returned gains are judged by ``design.semi_markov_loop.stability``, from the gains alone, not by these matrices.

References: thesis (2.18)-(2.21); ERRATA 1, 2 and 4.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Protocol

import numpy as np
from msgspec import Struct

from design.controllers.scheduled_gain import Schedule, ScheduledGain, tabulated
from design.errors import FieldError, Infeasible, check_at_least_zero
from design.lmi import as_float, decide
from design.lmi.program import Array, LmiProgram, LmiSolution, add_schur_rows, check_gain_bound, gain_limit, symmetric_part
from design.processes.partitions import Partition, equal_probability
from design.processes.semi_markov import SemiMarkov
from design.semi_markov_loop import JumpSystem, NormBounded
from design.semi_markov_loop.certificate import JumpCertificate, Method, check_stabilisable
from design.semi_markov_loop.sojourn_grid import Cell, refine, require_inverse
from design.semi_markov_loop.stability import CONDITION, analyse


def feedback_program(
    system: JumpSystem,
    process: SemiMarkov,
    nodes: Partition,
    method: Method,
    gain_bound: float,
    decay: float,
    condition: float,
    *,
    sound: bool = True,
) -> LmiProgram:
    """The synthesis problem on X[i,r], Y[i,r] and, under a norm-bounded uncertainty, eps[i,r].

    Not ``sound``, as it is printed, it has one for A and one for B; see ``along_cells``.
    """
    program = LmiProgram(reach=condition)
    n, m = system.states, system.inputs
    bounded = isinstance(system.uncertainty, NormBounded)
    scales = ["eps", "eps2"][: bounded * (1 if sound else 2)]
    for i, row in enumerate(nodes):
        for r in range(len(row)):
            x, y = f"X[{i},{r}]", f"Y[{i},{r}]"
            program.symmetric(x, n, least=1.0, most=condition)
            program.matrix(y, m, n)
            program.require(f"gain bound at {x}", partial(gain_limit, bound=gain_bound), x, y, strict=False)
            for scale in scales:
                program.symmetric(f"{scale}[{i},{r}]", 1, least=0.0, most=condition)
    blocks = [partial(_block, system=system, vertex=vertex, decay=decay) for vertex in system.vertices]
    require_inverse(program, blocks, process, nodes, method, at_nodes=("Y", *scales), sound=sound)
    return program


def _block(
    cell: Cell, x: Array, y: Array, *eps: Array, system: JumpSystem, vertex: int | None, decay: float
) -> list[list[Array | None]]:
    """The condition in the module's docstring, but for jumps and dX/dh."""
    i, uncertainty = cell.mode, system.uncertainty
    a, b = system.at(i, vertex, as_float)
    value = symmetric_part(a @ x + b @ y) + decay * x
    if not isinstance(uncertainty, NormBounded):
        return [[value]]
    rows: list[list[Array | None]] = [[value + sum(eps) * (uncertainty.e[i] @ uncertainty.e[i].T)]]
    of_state, of_input = uncertainty.fa[i] @ x, uncertainty.fb[i] @ y
    blocks = [of_state + of_input] if len(eps) == 1 else [of_state, of_input]
    add_schur_rows(rows, blocks, (scale * np.eye(block.shape[-2]) for scale, block in zip(eps, blocks)))
    return rows


def tabulate(found: LmiSolution, nodes: Partition, method: Method, schedule: Schedule, points: int) -> ScheduledGain:
    """K = Y X^-1 on a grid: ``points`` per cell (``pwl``), else one per section; ragged modes repeat their last gain."""
    schedule = schedule if method == "pwl" else "hold"
    rows = []
    for i, row in enumerate(nodes):
        table: list[tuple[float, Array]] = []
        for r, start in enumerate(row):
            last = r + 1 == len(row)
            x0, y0 = found.matrices[f"X[{i},{r}]"], found.matrices[f"Y[{i},{r}]"]
            if last or method != "pwl":
                table.append((start, y0 @ np.linalg.inv(x0)))
                continue
            x1, y1 = found.matrices[f"X[{i},{r + 1}]"], found.matrices[f"Y[{i},{r + 1}]"]
            for k in range(points):
                part = k / points
                at = part if schedule == "linear" else (k + 0.5) / points
                gain = ((1 - at) * y0 + at * y1) @ np.linalg.inv((1 - at) * x0 + at * x1)
                table.append((start + part * (row[r + 1] - start), gain))
        rows.append(table)
    return tabulated(rows, schedule)


class FeedbackRequest(Struct, frozen=True, kw_only=True):
    """Gains K(i, h) that make the loop mean-square stable for every admissible uncertainty and rate (Corollary 2.2, sound).

    Args:
        process: of the modes.
        gain_bound: largest spectral norm of any gain.
        sections: number of equal-probability sections, or a partition.
        method: ``pwl`` or ``pwc``.
        schedule, points: how K(h) of ``pwl`` is handed over: ``points`` per section,
            linear between them or held.
        condition: largest condition number of X that is searched.

    Raises:
        ValueError: data that do not fit.
    """

    process: SemiMarkov
    gain_bound: float
    sections: int | Partition = 2
    method: Method = "pwl"
    schedule: Schedule = "linear"
    points: int = 4
    condition: float = CONDITION

    def __post_init__(self) -> None:
        check_gain_bound(self.gain_bound)
        if self.method not in ("pwl", "pwc"):
            raise FieldError("method", f"{self.method!r} is not pwl or pwc")
        if self.points < 1:
            raise FieldError("points", f"{self.points}, expected at least 1")

    @property
    def starts(self) -> Partition:
        """Section starts per mode."""
        return equal_probability(self.process, self.sections) if isinstance(self.sections, int) else self.sections

    @property
    def nodes(self) -> Partition:
        """Nodes of X: the section starts and, for ``pwl``, the kinks of the rates."""
        return refine(self.process, self.starts, 1) if self.method == "pwl" else self.starts

    def __str__(self) -> str:
        return f"method {self.method}, {max(map(len, self.starts))} sections, gain norm <= {self.gain_bound:g}"

    def solve(self, system: JumpSystem, decay: float = 0.0) -> JumpCertificate:
        """Return the certificate of the gains (``.gain``), found again from the gains alone.

        Args:
            system: the plant.
            decay: demanded decay rate of E|x|^2 (1/s).

        Raises:
            ValueError: data that do not fit.
            Infeasible: no such gains exist (proved) or none could be certified; the message says.
        """
        return self.judge(system, self.find(system, decay), decay)

    def find(self, system: JumpSystem, decay: float, *, quick: bool = False) -> LmiSolution:
        """Solve the inequalities. Raises Infeasible with the proof, or (``quick``: at once) with the best margin reached."""
        check_at_least_zero(decay=decay)
        system.check(self.process)
        check_stabilisable(system, self.process)
        for condition in (self.condition, 0.1 * self.condition):  # a smaller box is easier to prove empty
            program = feedback_program(system, self.process, self.nodes, self.method, self.gain_bound, decay, condition)
            found = program.solve()
            if found.holds:
                return found
            if found.refused or quick:
                break
        else:
            found = decide(program)
            if found.holds:
                return found
        raise Infeasible(
            f"robust feedback ({self}, decay {decay:g}/s, I <= X <= {condition:g} I): {found.explain()}",
            value=found.margin,
        )

    def judge(self, system: JumpSystem, found: LmiSolution, decay: float) -> JumpCertificate:
        """Tabulate the gains and certify them from nothing but themselves. Raises Infeasible if that fails."""
        gain = tabulate(found, self.nodes, self.method, self.schedule, self.points)
        if gain.norm > self.gain_bound:  # the inequality holds to the solver's tolerance only
            gain = replace(gain, gain=gain.gain * (self.gain_bound / gain.norm))
        nodes = None if self.method == "pwl" else self.starts
        certificate = analyse(system, gain, self.process, method=self.method, nodes=nodes, parts=1, decay=decay)
        if certificate.certified:
            return certificate
        raise Infeasible(
            f"robust feedback ({self}, decay {decay:g}/s): gains found, but {certificate.reason}; more points may help",
            value=certificate.margin,
        )


class Synthesis(Protocol):
    """Conditions that gains are sought by: ``FeedbackRequest`` here, and the printed ones to be compared with."""

    def find(self, system: JumpSystem, decay: float, *, quick: bool = False) -> LmiSolution:
        """The matrices that fulfil them, or Infeasible."""

    def judge(self, system: JumpSystem, found: LmiSolution, decay: float) -> JumpCertificate:
        """The gains in these matrices with their certificate, or Infeasible."""


def largest_uncertainty(system: JumpSystem, request: Synthesis, *, tolerance: float = 1e-3) -> tuple[float, JumpCertificate]:
    """The largest scale of the system's uncertainty for which gains are certified, and the certificate of these gains.

    Bisection to a relative ``tolerance``. Raises as ``FeedbackRequest.solve`` does, where not even scale 0 has gains.
    """
    if system.uncertainty is None:
        raise FieldError("uncertainty", "there is none to scale")
    return _largest(lambda scale: (system.scaled(scale), 0.0), request, tolerance)


def fastest_feedback(system: JumpSystem, request: Synthesis, *, tolerance: float = 2e-3) -> JumpCertificate:
    """The gains with the largest certified decay rate of E|x|^2 under the gain bound, by bisection as above."""
    return _largest(lambda decay: (system, decay), request, tolerance)[1]


def _largest(
    problem: Callable[[float], tuple[JumpSystem, float]], request: Synthesis, tolerance: float
) -> tuple[float, JumpCertificate]:
    low, high, found = 0.0, math.inf, request.find(*problem(0.0))
    while high - low > tolerance * max(low, 1e-2):
        trial = max(1.0, 2.0 * low) if math.isinf(high) else 0.5 * (low + high)
        try:
            found = request.find(*problem(trial), quick=True)
            low = trial
        except Infeasible:
            high = trial
    for _ in range(8):  # at the very edge the tabulated gains may fail where Y X^-1 does not: step back a little
        try:
            system, decay = problem(low)
            return low, request.judge(system, found, decay)
        except Infeasible:
            low *= 1.0 - 4.0 * tolerance
            found = request.find(*problem(low))
    system, decay = problem(low)
    return low, request.judge(system, found, decay)
