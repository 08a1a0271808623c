r"""Gains of least cost whose largest input stays at a given peak, by the input weight of (5.18).

.. math:: \min_K \sum_k x^T \Xi x + \omega u^T u, \qquad \omega \text{ the least with } \max_k |u(k)| \le \text{peak}
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from design.errors import Infeasible
from design.historical_data.guaranteed_cost import Start, cost, start_at, synthesise
from design.historical_data.information import Mask
from design.historical_data.lifted_loop import Array, DelayedPlant, close

WEIGHTS = (1e-4, 1e4)
HALVINGS = 10
SLOTS = 400


class PeakMatch(NamedTuple):
    """The input weight, its gains, their largest |u|, and their cost without the input."""

    weight: float
    gains: Array
    peak: float
    cost: float


def largest_input(plant: DelayedPlant, gains: Array, x0: npt.ArrayLike, phase: int) -> float:
    """Return max |u(k)| of a run from x(0) with a zero history, over 400 slots.

    Args:
        plant: the plant.
        gains: (phases, memory + 1, p, n).
        x0: (n,).
        phase: of slot 0, from 0.
    """
    loop = close(plant, gains)
    phases, columns, p, n = gains.shape
    K = gains.transpose(0, 2, 1, 3).reshape(phases, p, columns * n)
    X, peak = np.zeros(loop.L.shape[-1]), 0.0
    X[:n] = x0
    for k in range(SLOTS):
        i = (phase + k) % phases
        peak = max(peak, float(np.abs(K[i] @ X[: columns * n]).max()))
        X = loop.L[i] @ X
    return peak


def match_peak(plant: DelayedPlant, mask: Mask, x0: npt.ArrayLike, phase: int, peak: float) -> PeakMatch:
    """Return the gains of least cost from x(0) whose input reaches at most the peak, by bisection over the weight.

    Args:
        plant: the plant and its state weight; its input weight is replaced.
        mask: (phases, memory + 1, n).
        x0: (n,).
        phase: of slot 0, from 0.
        peak: largest |u| that is allowed, input unit.

    Raises:
        Infeasible: even the largest weight tried leaves a larger input.
    """
    start, unit = start_at(x0, len(mask), phase), np.eye(plant.B.shape[1])
    low, high = np.log(WEIGHTS)
    kept = _solved(plant, mask, start, float(np.exp(high)), unit, None)
    if largest_input(plant, kept, x0, phase) > peak:
        raise Infeasible(f"no input weight up to {WEIGHTS[1]:g} keeps the input below {peak:g}", value=peak)
    while high - low > np.log(WEIGHTS[1] / WEIGHTS[0]) / 2**HALVINGS:
        middle = 0.5 * (low + high)
        gains = _solved(plant, mask, start, float(np.exp(middle)), unit, kept)
        if largest_input(plant, gains, x0, phase) <= peak:
            high, kept = middle, gains
        else:
            low = middle
    plain = replace(plant, input_weight=None)
    return PeakMatch(float(np.exp(high)), kept, largest_input(plant, kept, x0, phase), _cost(plain, kept, start))


def _solved(plant: DelayedPlant, mask: Mask, start: Start, weight: float, unit: Array, initial: Array | None) -> Array:
    return synthesise(replace(plant, input_weight=weight * unit), mask, start, initial=initial)


def _cost(plant: DelayedPlant, gains: Array, start: Start) -> float:
    return cost(close(plant, gains), start)
