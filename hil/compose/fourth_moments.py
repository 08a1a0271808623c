"""Beside the certificate of a loop: whether the mean of its squared errors converges as means of many runs do."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from design.controllers import GainTable, integrates
from hil.plugins.protocols import JumpPlant
from hil.rig.delay_chains import gains_over
from hil.rig.loop import Loop

if TYPE_CHECKING:
    from design.jump_linear.fourth_moment import FourthMoments


def fourth_moments_of(loop: Loop) -> FourthMoments | None:
    """Return how the fourth moments of a loop's linear model grow; None where no chain of delays describes the loop.

    Args:
        loop: the composed experiment.
    """
    from design.blas_threads import one_blas_thread
    from design.jump_linear.fourth_moment import fourth_moments
    from design.networked_loop.closed_loop import loop_structure

    if not isinstance(loop.controller, GainTable) or isinstance(loop.experiment.plant, JumpPlant):
        return None
    sc, ca = loop.chains.sc, loop.chains.ca
    if sc is None or ca is None:
        return None
    model, controller = loop.model, loop.controller
    structure = loop_structure(
        model.A, model.B, model.C, sc, ca, controller.selection, samples=loop.samples, integral=float(integrates(controller))
    )
    closed = structure.matrices(gains_over(controller, model, sc, ca))
    with one_blas_thread(), np.errstate(all="ignore"):
        return fourth_moments(closed, structure.transition, upper=None if structure.between is None else structure.between[1])


def caution(loop: Loop) -> str:
    """Return what is to be said beside a mean of squared errors over runs of a loop; nothing where it converges."""
    found = fourth_moments_of(loop)
    if found is None or found.state == "bounded":
        return ""
    if found.state == "undecided":
        return f"whether a mean of squared errors converges well is undecided: {found.reason}"
    number = "" if found.radius is None else f" (radius {found.radius:.5g})"
    growth = f"fourth moments of the linear loop grow{number}"
    if loop.verdict is not None and loop.verdict.number is not None and loop.verdict.number >= 1.0:
        return f"{growth}, and so do second ones ({loop.verdict.number:.5g}): a mean of squared errors grows with the duration"
    return f"{growth}: a mean of squared errors converges badly, and its interval is too narrow"
