"""The mixed design (7.33) as a curve: the smallest H2 norm for H-infinity levels between those of the two pure designs.

A weight w in [0, 1] says how much of the H-infinity norm is given up: level(w) = gamma_inf (gamma_2 / gamma_inf)^w, with
gamma_inf the smallest norm and gamma_2 that of the H2 design. w = 0 is the H-infinity design, w = 1 the H2 design.

Reference: thesis (7.33).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from design.errors import Infeasible
from design.requests.tracking import solve_tracking
from design.tracking.synthesis import Design, Progress
from hil.design_questions.design_problem import TrackingTarget, problem_for, verdict_on
from hil.errors import HilError

WEIGHTS: Final = (0.01, 0.05, 0.1, 0.2, 0.35, 0.5, 0.75)
"""Between the pure designs: closer near the H-infinity one, where the H2 norm changes fastest."""

SAME: Final = 1e-4
"""Share by which the H2 design's H-infinity norm may be above the smallest, and there still is nothing to trade."""


class Compromise(NamedTuple):
    """A design: its weight, the level of its H-infinity norm (None: not bounded), norms, gains, and its certificate's state."""

    weight: float
    level: float | None
    h2: float
    hinf: float
    gains: NDArray[np.float64]
    state: str

    def to_json(self) -> dict[str, object]:
        """Return it as plain values."""
        return {**self._asdict(), "gains": self.gains.tolist()}


def compromises(
    target: TrackingTarget, progress: Progress | None = None, weights: Sequence[float] = WEIGHTS, **options: Any
) -> list[Compromise]:
    """Return designs by weight, from the H-infinity design to the H2 design.

    A mixed design that no other one on the curve improves in both norms; of each level the best design that is known meets it.

    Args:
        target: plant and network.
        progress: as `solve_tracking` takes it.
        weights: between 0 and 1, rising.
        options: of the problem, without objective and level.

    Raises:
        HilError: an option that does not fit.
        DesignError: no gains meet the request.
    """

    def solved(weight: float, objective: str, level: float | None = None) -> Compromise:
        design = solve_tracking(problem_for(target, objective=objective, hinf_bound=level, **options), progress=progress)
        return _compromise(target, design, weight, level)

    least, most = solved(0.0, "hinf"), solved(1.0, "h2")
    if most.hinf <= (1.0 + SAME) * least.hinf:
        raise HilError(f"--trade-off: the H2 design has the smallest H-infinity norm, too ({most.hinf:.6g}): nothing to trade")
    found = [least]
    for weight in weights:
        level = least.hinf * (most.hinf / least.hinf) ** weight
        try:
            each = solved(weight, "mixed", level)
        except Infeasible:  # its own search ends above a level that the pure design meets
            each = found[-1]._replace(weight=weight, level=level)
        # What meets a tighter level meets this one, too.
        found.append(min((each, found[-1]._replace(weight=weight, level=level)), key=lambda one: one.h2))
    return [*found, most]


def _compromise(target: TrackingTarget, design: Design, weight: float, level: float | None) -> Compromise:
    c = design.certificate
    norms = [np.nan if norm is None else float(norm) for norm in (c.h2_norm, c.hinf_norm)]
    return Compromise(weight, level, norms[0], norms[1], design.gains, verdict_on(target, design).state)
