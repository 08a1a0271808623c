"""The smallest gamma of a set of inequalities that hold a scalar "g2" = (scale gamma)^2, found so that it can be trusted.

A semidefinite solver's tolerance is absolute: with gamma^2 = 4e-4 it stops up to 2.6 times above the optimum and says
"optimal". So z is scaled until scale gamma is about 1, gamma is then fixed slightly above the optimum, the margin of all
strict inequalities is maximised, and the matrices found there are verified.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from design.errors import FieldError, Infeasible
from design.lmi.decision import decide
from design.lmi.program import LmiProgram, LmiSolution

BACKOFF = (1e-3, 3e-3, 1e-2, 3e-2, 0.1, 0.3)
"""Relative distances from the solver's optimum at which a verified interior solution is sought, in this order."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Attenuation:
    """A gamma whose inequalities were verified: the matrices of ``found`` belong to z scaled by ``scale``."""

    gamma: float
    scale: float
    found: LmiSolution


def with_gamma(program: LmiProgram, scaled_gamma: float) -> LmiProgram:
    """The same program with "g2" known."""
    known = {"g2": np.array([[scaled_gamma**2]])}
    fixed = LmiProgram(reach=program.reach)
    for name, variable in program.variables.items():
        if name != "g2":
            fixed.add(name, variable.basis)
    fixed.inequalities = [item.fixing(known) for item in program.inequalities if item.on != ("g2",)]
    return fixed


def smallest_gamma(build: Callable[[float], LmiProgram], what: str) -> Attenuation:
    """Minimise gamma over ``build(scale)``; ``what`` names the request in the error.

    Raises:
        Infeasible: nothing could be verified; the message says whether dual matrices prove that nothing is there.
    """
    scale, gamma = 1.0, math.inf
    for _ in range(6):
        objective = build(scale).solve("g2").objective
        if not math.isfinite(objective):
            break
        before, gamma = gamma, math.sqrt(max(objective, 1e-4)) / scale
        if 0.8 < scale * gamma < 1.25 or abs(before / gamma - 1.0) < 1e-3:
            break
        scale = 1.0 / gamma
    if math.isfinite(gamma):
        program = build(scale)
        for backoff in BACKOFF:
            trial = (1.0 + backoff) * gamma
            found = with_gamma(program, scale * trial).solve()
            if found.holds:
                return Attenuation(gamma=trial, scale=scale, found=found)
    return at_gamma(build, 100.0, what)


def at_gamma(build: Callable[[float], LmiProgram], gamma: float, what: str) -> Attenuation:
    """A verified solution at the given gamma. Raises Infeasible as ``smallest_gamma`` does."""
    if not math.isfinite(gamma) or gamma <= 0:
        raise FieldError("gamma", f"{gamma!r} is not a finite positive number")
    found = decide(with_gamma(build(1.0 / gamma), 1.0))
    if not found.holds:
        raise Infeasible(f"{what} at gamma = {gamma:g}: {found.explain()}", value=found.margin, proved=found.refused)
    return Attenuation(gamma=gamma, scale=1.0 / gamma, found=found)
