"""A plant that jumps, in the words of the theory: its own matrices and rates, handed over and nowhere typed again."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from plants.parts.events import JumpModel, JumpRates
from plants.parts.semi_markov import TransitionRates

if TYPE_CHECKING:
    from design.processes.semi_markov import FaultDetection, SemiMarkov
    from design.semi_markov_loop.system import DelayedJumpSystem, JumpSystem


def system_of(plant: JumpModel) -> JumpSystem | DelayedJumpSystem:
    """Return the matrices of a plant as a system of Chapters 2 to 4.

    Raises:
        ValueError: matrices that do not fit each other, a delay that grows as fast as time (3.2), or both a delay inside and
            uncertain matrices, for which there is no theory.
    """
    from design.semi_markov_loop.system import DelayedJumpSystem, JumpSystem, VertexUncertainty

    a, b = np.array(plant.A, dtype=float), np.array(plant.B, dtype=float)
    c = np.array(plant.C, dtype=float) if plant.C else None
    e = np.array(plant.E, dtype=float) if plant.E else None
    if plant.Ad:
        if plant.changes:
            raise ValueError("changes: no theory covers uncertain matrices together with an internal delay")
        return DelayedJumpSystem(
            a=a, ad=np.array(plant.Ad, dtype=float), b=b, delay_max_s=plant.max_delay_s,
            delay_slopes=np.array(plant.delay_slopes, dtype=float),
            c=np.broadcast_to(np.eye(a.shape[1]), a.shape) if c is None else c, e=b if e is None else e,
        )  # fmt: skip
    vertices = None
    if plant.changes:
        dA, dB = (np.array([change[k] for change in plant.changes], dtype=float) for k in (0, 1))
        vertices = VertexUncertainty(da=dA, db=dB)
    return JumpSystem(a=a, b=b, c=c, e=e, uncertainty=vertices)


def process_of(rates: JumpRates) -> SemiMarkov | FaultDetection:
    """Return the rates of a plant as a process of Chapters 2 and 3, or of Chapter 4 where only the detected mode is measured."""
    from design.processes.semi_markov import FaultDetection

    if not rates.detection:
        return _semi_markov(rates.rates)
    return FaultDetection(
        failure=_semi_markov(rates.rates),
        detection=tuple(_semi_markov(table) for table in rates.detection),
        failure_restarts_detection_clock=rates.failure_restarts_detection_clock,
    )


def _semi_markov(table: TransitionRates) -> SemiMarkov:
    from design.processes.rates import PiecewiseLinearRate
    from design.processes.semi_markov import SemiMarkov

    def rate(i: int, j: int) -> PiecewiseLinearRate | None:
        values = tuple(matrix[i][j] for matrix in table.rates)
        return PiecewiseLinearRate(times_s=table.nodes_s, values=values) if i != j and any(values) else None

    return SemiMarkov(rates=tuple(tuple(rate(i, j) for j in range(table.modes)) for i in range(table.modes)))
