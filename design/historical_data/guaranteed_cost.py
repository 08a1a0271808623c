r"""What scheduled gains cost, and the gains that cost least: freely, or with the largest input at a given peak.

.. math:: J = E \sum_k x(k)^T \Xi x(k) + u(k)^T \Xi_u u(k) = \sum_i \operatorname{tr}(S_i W_i)

S is the cost-to-go of the lifted loop and W_i = Pr(phase i at 0) E X(0) X(0)'. With G_i the sum of E X X' over the slots of
phase i,

.. math:: \partial J / \partial K_i = 2 (\tilde B^T E_i(S) L_i + \Xi_u K_i) G_i

DEVIATION: Theorem 5.1 bounds J by a functional that is block diagonal in the past; its conditions are infeasible on the chapter's
own example (see `design.as_printed.chapter5`). The Lyapunov equation on the stacked state is necessary and sufficient.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import permutations
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from design.errors import Infeasible, NotStable
from design.historical_data.lifted_loop import Array, DelayedPlant, LiftedLoop, close
from design.historical_data.measurement_noise import cost_from, stationary_cost
from design.historical_data.sensor_schedule import Mask
from design.verdict import Verdict

EASIER = 0.97  # the matrices of a loop that is not stable yet are scaled until they are, and this much less with every round
ROUNDS = 400


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Start:
    """Where a run begins: its second moment, with a zero history.

    Args:
        moment: E x(0) x(0)', (n, n).
        phases: probability of each phase in slot 0.
    """

    moment: Array
    phases: Array

    def lifted(self, size: int) -> Array:
        """Return Pr(phase) E X(0) X(0)', (phases, size, size)."""
        n, W = len(self.moment), np.zeros((len(self.phases), size, size))
        W[:, :n, :n] = self.phases[:, None, None] * self.moment
        return W


def average_start(states: int, phases: int) -> Start:
    """Return the honest criterion: x(0) ~ N(0, I), every phase equally likely."""
    return Start(moment=np.eye(states), phases=np.full(phases, 1.0 / phases))


def start_at(x0: npt.ArrayLike, phases: int, phase: int) -> Start:
    """Return the start from one state in one phase, counted from 0."""
    x = np.asarray(x0, dtype=float)
    return Start(moment=np.outer(x, x), phases=np.eye(phases)[phase])


def cost(loop: LiftedLoop, start: Start) -> float:
    """Return J exactly.

    Raises:
        NotStable: J is infinite.
    """
    return float(np.einsum("iab,iab->", loop.cost_to_go(), start.lifted(loop.L.shape[-1])))


def certify_cost(
    plant: DelayedPlant,
    gains: Array,
    start: Start,
    transition: Array | None = None,
    *,
    history: Array | None = None,
    deviation: Array | None = None,
    renewed: npt.NDArray[np.bool_] | None = None,
) -> Verdict:
    """Return the verdict on scheduled gains: the growth of E|X|^2 per slot, and the cost.

    Args:
        plant: the plant (5.1) and its weights.
        gains: (phases, memory + 1, p, n).
        start: where the run begins.
        transition: chain of the phases; default the cycle.
        history: x(0), x(-1), ... of the run, (h, n): the cost is then from there, whatever the start's moment; default zero.
        deviation: standard deviation of the noise on every state, (n,); default none. The cost is without it, and its own
            long-run cost per slot is beside.
        renewed: (phases, n), as of `design.historical_data.lifted_loop.close`; the gains then have a column more.
    """
    loop = close(plant, gains, transition, renewed=renewed)
    past, noisy = history is not None and bool(np.any(history[1:])), deviation is not None and bool(np.any(deviation))
    radius = loop.radius()
    margin = 64 * loop.L.shape[-1] * float(np.finfo(float).eps)
    stable = radius < 1.0 - margin
    details: dict[str, object] = {"phases": len(gains), "order": loop.L.shape[-1]}
    if stable:
        try:
            S = loop.stable_cost_to_go()
            details["cost"] = float(np.einsum("iab,iab->", S, start.lifted(loop.L.shape[-1])))
            details["residual"] = _residual(loop, S)
            if past and history is not None:
                details["cost"] = cost_from(plant, gains, history, start.phases, transition, renewed)
            if noisy and deviation is not None:
                details["noise_cost_per_slot"] = stationary_cost(plant, gains, deviation, transition, start.phases, renewed)
        except NotStable:
            stable = False
    return Verdict(
        kind="guaranteed cost",
        state="certified" if stable else "refused" if radius > 1.0 + margin else "undecided",
        reason=f"E|X|^2 of the stacked state {'falls' if stable else 'does not fall'}: factor {radius:.6g} per slot",
        number=radius, quantity="growth of E|X|^2 per slot", limit=1.0,
        assumptions=(
            "the history before slot 0 is the plant's, not received" if past else "the history before slot 0 is zero",
            *(["sensor noise is white, drawn anew for every sample; the cost is without it"] if noisy else []),
            "the phases follow the cycle" if transition is None else "the phases follow the chain", "no packet is lost",
        ),
        method="Lyapunov equation on the stacked state, exact", details=details,
    )  # fmt: skip


def _residual(loop: LiftedLoop, S: Array) -> float:
    expected = np.einsum("ij,jab->iab", loop.transition, S)
    gap = loop.Q + loop.L.transpose(0, 2, 1) @ expected @ loop.L - S
    return float(np.abs(gap).max() / np.abs(S).max())


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
