r"""The gains that cost least: freely, with the largest input at a given peak, or in the best order of the nodes.

.. math:: \partial J / \partial K_i = 2 (\tilde B^T E_i(S) L_i + \Xi_u K_i) G_i

S is the cost-to-go of the lifted loop, G_i the sum of E X X' over the slots of phase i; the cost is that of
`design.historical_data.guaranteed_cost`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import permutations
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from msgspec import structs

from design.controllers.sensor_nodes import SensorNodes, Turns
from design.errors import FieldError, Infeasible, NotStable
from design.historical_data import Array, DelayedPlant, LiftedLoop, close
from design.historical_data.guaranteed_cost import Start, cost, start_at
from design.historical_data.sensor_schedule import Mask, mask_of

EASIER = 0.97  # the matrices of a loop that is not stable yet are scaled until they are, and this much less with every round
ROUNDS = 400
MOST_NODES = 6
"""(6 - 1)! = 120 orders; a search by trying all ends here."""


def synthesise(
    plant: DelayedPlant,
    mask: Mask,
    start: Start,
    *,
    transition: Array | None = None,
    initial: Array | None = None,
) -> Array:
    """Return gains of least cost under a mask, by quasi-Newton descent with the exact gradient.

    Args:
        plant: the plant (5.1) and its weights.
        mask: (phases, memory + 1, n), which entries may differ from zero.
        start: what the cost is averaged over.
        transition: chain of the phases; default the cycle.
        initial: gains to start from; default zero.

    Returns:
        K of shape (phases, memory + 1, p, n); a local optimum.

    Raises:
        Infeasible: no stable gains were found.
    """
    phases, columns, n = mask.shape
    p = plant.B.shape[1]
    free = np.broadcast_to(mask[:, :, None, :], (phases, columns, p, n))
    zero = np.zeros(free.shape)
    base = close(plant, zero, transition)
    A, B, weight, input_weight = plant.matrices(max(columns - 1, plant.memory))
    W = start.lifted(A.shape[0])

    last: dict[str, Array] = {}  # of the gains that were tried before

    def gains_of(v: Array) -> Array:
        K = np.zeros(free.shape)
        K[free] = v
        return K

    def value(v: Array, scale: float) -> tuple[float, Array]:
        K = gains_of(v)
        flat = np.zeros((phases, p, A.shape[0]))
        flat[:, :, : n * columns] = K.transpose(0, 2, 1, 3).reshape(phases, p, -1)
        loop = LiftedLoop(
            L=scale * (A + B @ flat), Q=weight + flat.transpose(0, 2, 1) @ input_weight @ flat, transition=base.transition
        )
        try:
            S, G = loop.cost_to_go(last.get("S")), loop.gramian(W, last.get("G"))
        except NotStable:
            return np.inf, np.zeros_like(v)
        last.update(S=S, G=G)
        later = np.tensordot(base.transition, S, axes=1)
        gradient = 2.0 * (scale * B.T @ later @ loop.L + input_weight @ flat) @ G
        shaped = gradient[:, :, : n * columns].reshape(phases, p, columns, n).transpose(0, 2, 1, 3)
        return float(np.einsum("iab,iab->", S, W)), shaped[free]

    v = (zero if initial is None else initial)[free]
    scale = _stable_scale(value, v)
    for _ in range(ROUNDS):
        goal = min(1.0, scale)
        v = _descend(lambda x, s=goal: value(x, s), v, goal == 1.0)  # type: ignore[misc]
        if goal == 1.0:
            return gains_of(v)
        larger = _stable_scale(value, v) if np.isfinite(value(v, 1.0)[0]) else _largest_scale(value, v, goal)
        if larger <= goal * (1 + 1e-6):
            raise Infeasible("no gains of this information stabilise the plant over this schedule", value=goal)
        scale = larger
    raise Infeasible("no gains of this information stabilise the plant over this schedule", value=scale)


def _stable_scale(value: Callable[[Array, float], tuple[float, Array]], v: Array) -> float:
    scale = 1.0
    while not np.isfinite(value(v, scale)[0]):
        scale *= EASIER
        if scale < 1e-6:
            raise Infeasible("no scaling of the loop is stable: the initial gains are too large", value=scale)
    return scale


def _largest_scale(value: Callable[[Array, float], tuple[float, Array]], v: Array, good: float) -> float:
    """The largest scale up to 1 at which the loop has a finite cost, short of it by a share, so that descent has room."""
    bad = 1.0
    for _ in range(30):
        middle = 0.5 * (good + bad)
        good, bad = (middle, bad) if np.isfinite(value(v, middle)[0]) else (good, middle)
    return good * 0.999 if good < 1.0 else 1.0


def _descend(objective: Callable[[Array], tuple[float, Array]], v: Array, finish: bool) -> Array:
    from scipy.optimize import minimize  # 0.3 s: a run that certifies its gains does not look for others

    found = minimize(objective, v, jac=True, method="BFGS", options={"maxiter": 1500 if finish else 40, "gtol": 1e-9})
    return np.asarray(found.x) if np.isfinite(found.fun) else v


def cyclic_orders(nodes: int) -> Iterator[tuple[int, ...]]:
    """Yield every cyclic order of the nodes once, node 0 first.

    >>> list(cyclic_orders(3))
    [(0, 1, 2), (0, 2, 1)]
    """
    for rest in permutations(range(1, nodes)):
        yield (0, *rest)


class OrderCost(NamedTuple):
    """An order of the nodes, the gains of least cost under it, and that cost."""

    order: tuple[int, ...]
    gains: Array
    cost: float


def orders_by_cost(plant: DelayedPlant, nodes: SensorNodes, start: Start, memory: int | None = None) -> list[OrderCost]:
    """Return every cyclic order of the nodes with its best gains, the cheapest first.

    Args:
        plant: the plant and its weights.
        nodes: who measures what, buffers and delays; their turns are not used.
        start: what the cost is averaged over.
        memory: the oldest sample that the controller uses, as `mask_of` takes it.

    Raises:
        ValueError: more nodes than can be tried.
        Infeasible: no gains stabilise the plant under some order.
    """
    count = len(nodes.names)
    if count > MOST_NODES:
        raise FieldError("nodes", f"{count} of them, at most {MOST_NODES} can be put into every order")
    found = []
    for order in cyclic_orders(count):
        gains = synthesise(plant, mask_of(structs.replace(nodes, turns=Turns(order=order)), memory), start)
        found.append(OrderCost(order, gains, cost(close(plant, gains), start)))
    return sorted(found, key=lambda each: each.cost)


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
    r"""Return the gains of least cost from x(0) whose input reaches at most the peak, by bisection over the weight.

    The input weight is that of (5.18).

    .. math:: \min_K \sum_k x^T \Xi x + \omega u^T u, \qquad \omega \text{ the least with } \max_k |u(k)| \le \text{peak}

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

    def solved(log_weight: float, initial: Array | None = None) -> Array:
        return synthesise(replace(plant, input_weight=float(np.exp(log_weight)) * unit), mask, start, initial=initial)

    low, high = np.log(WEIGHTS)
    kept = solved(high)
    if largest_input(plant, kept, x0, phase) > peak:
        raise Infeasible(f"no input weight up to {WEIGHTS[1]:g} keeps the input below {peak:g}", value=peak)
    while high - low > np.log(WEIGHTS[1] / WEIGHTS[0]) / 2**HALVINGS:
        middle = 0.5 * (low + high)
        gains = solved(middle, kept)
        if largest_input(plant, gains, x0, phase) <= peak:
            high, kept = middle, gains
        else:
            low = middle
    plain = close(replace(plant, input_weight=None), kept)
    return PeakMatch(float(np.exp(high)), kept, largest_input(plant, kept, x0, phase), cost(plain, start))
