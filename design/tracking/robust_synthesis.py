"""Gains of least guaranteed cost for a plant that is known to a share only: (7.41) as a design.

Over all |Delta| <= 1 in [dA dB] = M Delta [N1 N2] the H2 norm is at most sqrt(f(K, lambda)) for every multiplier lambda > 0 that
has a bound (`design.networked_loop.uncertainty`). Gains and multiplier are descended together, from the gains without
uncertainty; where those do not bear all of it, first the H-infinity norm of Delta's channel is lowered until they do.

Slopes are central differences: each is a bounded-real equation, and there are as many as free gains. An `EquationBudget` bounds
their number, by counting and not by a clock: the gains found do not depend on the machine.

Reference: thesis (7.41), Remark 7.6.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
import numpy.typing as npt

from design.errors import DesignError
from design.networked_loop.uncertainty import guaranteed_h2, robust_h2, uncertainty_margin
from design.processes.delay_chain import Array
from design.tracking.bfgs import Objective, bfgs
from design.tracking.synthesis import Design, Progress, certified

STEP: Final = 1e-5
"""Of a difference, relative to the size of the coordinates."""

KNOWN: Final = 1e-9
"""Share to which a guaranteed cost is known: ends of a difference that are no farther apart say no slope."""

ENOUGH: Final = 1.02
"""Margin with which the descent of the guaranteed cost begins."""

NORM: Final = 10
"""Equations that an H-infinity norm counts as; it takes 6 to 15."""

GUARANTEE: Final = 35
"""Equations that a guaranteed norm counts as: one for every multiplier that is tried, and the norm of the channel."""


class BudgetSpent(Exception):
    """A search asked for more equations than its budget has left."""


class EquationBudget:
    """Bounded-real equations that searches may still solve.

    Args:
        equations: how many.
    """

    def __init__(self, equations: int) -> None:
        self.left, self.spent = equations, False

    def take(self, equations: int) -> None:
        """Count equations that are solved next.

        Raises:
            BudgetSpent: there are fewer left; `spent` says so from now on.
        """
        if equations > self.left:
            self.spent = True
            raise BudgetSpent
        self.left -= equations

    def part(self, parts: int, reserve: int = 0) -> EquationBudget:
        """Return one of equal parts of what is left, less a reserve that stays here; `back` takes what it leaves."""
        given = max(0, self.left // parts - reserve)
        self.left -= given
        return EquationBudget(given)

    def back(self, part: EquationBudget) -> None:
        """Take back what a part has not used."""
        self.left, part.left = self.left + part.left, 0


def robust(
    design: Design, M: npt.ArrayLike, N1: npt.ArrayLike, N2: npt.ArrayLike, *, progress: Progress | None = None,
    budget: EquationBudget | None = None,
) -> Design:  # fmt: skip
    """Return the design with gains of least guaranteed H2 norm; of the largest margin found, where none bear |Delta| <= 1.

    Where the budget ends first, they are the best found so far.

    Args:
        design: gains for the nominal plant, of the problem whose information pattern and bounds are kept.
        M, N1, N2: (n, a), (b, n), (b, m).
        progress: called with the stage, 1, 1 and the value, at every point of the search.
        budget: of equations; its `spent` says afterwards whether it cut the search short. None: no bound but the iterations'.

    Raises:
        NotStable: the gains found have no certificate.
        ValueError: matrices that do not fit.
    """
    problem = design.problem
    structure, space, report = problem.structure(), problem.space(), progress or (lambda stage, start, starts, value: None)
    alpha, count = problem.alpha(structure), 0

    def take(equations: int) -> None:
        nonlocal count
        if budget is not None:
            budget.take(equations)
        count += equations

    def channel(v: Array) -> float:
        take(NORM)
        try:
            return 1.0 / uncertainty_margin(structure, space.gains(v), M, N1, N2)
        except DesignError:  # not stable
            return np.inf

    def cost(x: Array) -> float:
        take(1)
        return guaranteed_h2(structure, space.gains(x[:-1]), M, N1, N2, alpha, float(10.0 ** x[-1]))

    v = space.coordinates(design.gains)
    try:
        if channel(v) > 1.0 / ENOUGH:
            margin = _Kept(channel, v)
            try:
                shown = _with_slope(margin, lambda value: report("margin", 1, 1, 1.0 / value if value else np.inf))
                v = bfgs(shown, v, value_tolerance=1e-7, iterations=200, stop=lambda value: value < 1.0 / ENOUGH).x
            except BudgetSpent:
                v = margin.best
        if channel(v) < 1.0:
            take(GUARANTEE)
            _, multiplier = robust_h2(structure, space.gains(v), M, N1, N2, problem.initial)
            x = np.append(v, np.log10(multiplier))
            guarantee = _Kept(cost, x)
            try:
                for _ in range(2):  # once more with a forgotten Hessian
                    shown = _with_slope(guarantee, lambda value: report("guaranteed h2", 1, 1, value))
                    x = bfgs(shown, x, value_tolerance=1e-9, iterations=200).x
            except BudgetSpent:
                x = guarantee.best
            v = x[:-1]
    except BudgetSpent:  # between two descents
        pass
    return certified(problem, space.gains(v), starts=design.starts, evaluations=design.evaluations + count)


class _Kept:
    """A function that keeps the point of its least value so far."""

    def __init__(self, value: Callable[[Array], float], start: Array) -> None:
        self._value, self.best, self._least = value, start, np.inf

    def __call__(self, v: Array) -> float:
        found = self._value(v)
        if found < self._least:
            self.best, self._least = v.copy(), found
        return found


def _with_slope(value: Callable[[Array], float], report: Callable[[float], None]) -> Objective:
    """The value and its central differences; one-sided where a step leaves the domain."""

    def both(v: Array) -> tuple[float, Array]:
        here, slope = value(v), np.zeros_like(v)
        if not np.isfinite(here):
            return np.inf, slope
        report(here)
        step = STEP * max(1.0, float(np.abs(v).max()))
        for i in range(v.size):
            ends = [(s * step, value(v + s * step * np.eye(v.size)[i])) for s in (-1.0, 1.0)]
            known = [(at, found) for at, found in ends if np.isfinite(found)] or [(0.0, here)]
            known = known if len(known) == 2 else [*known, (0.0, here)]
            width, rise = known[1][0] - known[0][0], known[1][1] - known[0][1]
            slope[i] = rise / width if width and abs(rise) > KNOWN * abs(here) else 0.0
        return here, slope

    return both
