"""What a run over scheduled sensors costs at least, for any controller, and how its cost is spread over random schedules.

The bounds are those with the whole state known, and with what its packets bring.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
from msgspec import Struct

from design.controllers.sensor_nodes import SensorNodes
from design.errors import Infeasible, NotStable
from design.historical_data import Array, DelayedPlant, LiftedLoop, cycle
from design.historical_data.sensor_schedule import undecided_because
from design.jump_linear.higher_moments import power

RARE: Final = 1e-5
"""Branches of this probability are left."""

BRANCHES: Final = 20_000
KNOWN: Final = 1e-12
"""A direction that the packets show with a smaller share of the spread is rounding, and counts as unseen."""

Seen = tuple[tuple[int, int, int], ...]
"""Of what a slot brings: (state, age of the newest sample, samples)."""


class Arrivals(Struct, frozen=True, kw_only=True):
    """Whose packet comes when, as a Markov chain of phases.

    Args:
        transition: (phases, phases).
        start: probability of each phase in slot 0.
        seen: per phase, what its slot brings.
        loss: probability that it brings nothing.
    """

    transition: Array
    start: Array
    seen: tuple[Seen, ...]
    loss: float = 0.0


def arrivals_of(nodes: SensorNodes) -> Arrivals | None:
    """Return whose packet comes when; None where this is no chain of its own: triggers, clocks that draw, delays that change.

    Slot 0 is any slot of a cycle, each as likely as another.

    Args:
        nodes: the sensor nodes.
    """
    turns, delays = nodes.turns, [delay for delay in nodes.delays if delay is not None]
    if undecided_because(nodes) or nodes.silent:
        return None

    def brought(node: int, age: int) -> Seen:
        return tuple((state, age + delays[node], nodes.buffers[node]) for state in nodes.outputs[node])

    if turns is None:
        every = tuple(entry for node in range(len(nodes.names)) for entry in brought(node, 0))
        return Arrivals(transition=np.ones((1, 1)), start=np.ones(1), seen=(every,))
    if len(set(delays)) > 1 or (turns.loss and any(len(slot) > 1 for slot in turns.cycle)):
        return None
    if turns.cycle:
        phases = len(turns.cycle)
        seen = tuple(
            tuple(e for node, age in turns.cycle[(i - delays[0]) % phases] for e in brought(node, age)) for i in range(phases)
        )
        return Arrivals(transition=cycle(phases), start=np.full(phases, 1.0 / phases), seen=seen, loss=turns.loss)
    return Arrivals(
        transition=np.array(turns.transition), start=np.array(turns.initial),
        seen=tuple(brought(node, 0) for node in range(len(nodes.names))), loss=turns.loss,
    )  # fmt: skip


def full_state_bound(plant: DelayedPlant, history: Array) -> float:
    """Return the least cost from a known past, for any controller over any network: X(0)' S X(0).

    The full-state bound holds for any schedule, loss, trigger or delay: each only takes knowledge or freedom away.

    Args:
        plant: the plant (5.1) and its weights.
        history: x(0), x(-1), ..., (h, n); zero before.
    """
    memory = max(plant.memory, len(history) - 1)
    S = _regulator(plant, memory)[0]
    X = np.zeros(len(S))
    X[: history.size] = history.ravel()
    return float(X @ S @ X)


def mean_full_state_bound(plant: DelayedPlant, moment: Array) -> float:
    """Return the least mean cost from E x(0) x(0)' = moment, (n, n), and a zero history, for any controller over any network."""
    n = len(plant.A)
    return float(np.trace(_regulator(plant, plant.memory)[0][:n, :n] @ moment))


def causal_bound(plant: DelayedPlant, arrivals: Arrivals, moment: Array) -> float:
    r"""Return what no causal controller can go below in the mean; it knows what the packets brought, and where x(0) comes from.

    The best causal controller is the linear quadratic regulator on the conditional mean of the stacked state: which packet comes,
    and what is lost, depends neither on the state nor on the input, so separation holds over a random schedule as over a cycle.
    It costs

    .. math:: J = \operatorname{tr} S W + \sum_k E \operatorname{tr} K^T (\Xi_u + B^T S B) K \, \Sigma(k)

    with S the regulator's cost-to-go, K its gain, and Sigma(k) the error covariance after the packets of slot k. The plant has no
    process noise: Sigma(k) = F F', and a packet that shows the entries y of X takes F to F Z, Z a basis of the kernel of F_y.
    Where the schedule is random the expectation is the sum over the tree of outcomes. A branch is left where nothing is unknown
    or where it hardly ever comes: every term is at least 0, so that the sum stays a lower bound.

    Args:
        plant: the plant (5.1) and its weights.
        arrivals: whose packet comes when.
        moment: E x(0) x(0)', (n, n); the history is zero.
    """
    n = len(plant.A)
    memory = max(plant.memory, max((age + count - 1 for seen in arrivals.seen for _, age, count in seen), default=0))
    S, price = _regulator(plant, memory)
    A = plant.matrices(memory)[0]
    values, vectors = np.linalg.eigh(moment)
    root = np.zeros((len(A), n))
    root[:n] = vectors * np.sqrt(np.maximum(values, 0.0))
    full, extra = float(np.trace(S[:n, :n] @ moment)), 0.0
    rows = [np.array([j * n + i for i, age, count in seen for j in range(age, age + count)], int) for seen in arrivals.seen]
    live = [(float(share), i, root) for i, share in enumerate(arrivals.start) if share > 0.0]
    slots = 0
    while live and slots < 10_000:
        later: list[tuple[float, int, Array]] = []
        for share, phase, F in live:
            outcomes = [(1.0 - arrivals.loss, _without(F, rows[phase])), *([(arrivals.loss, F)] if arrivals.loss else [])]
            for chance, known in outcomes:
                added = share * chance * float(np.vdot(known, price @ known))
                extra += added
                if not known.size or added <= 1e-10 * full:
                    continue
                moved = A @ known
                later += [
                    (share * chance * p, j, moved) for j, p in enumerate(arrivals.transition[phase]) if share * chance * p > RARE
                ]
        live = sorted(later, key=lambda branch: -branch[0])[:BRANCHES]
        slots += 1
    return full + float(extra)


def _without(F: Array, rows: npt.NDArray[np.int_]) -> Array:
    """Return F Z, with Z a basis of the kernel of F's rows: what is left unknown once they are seen."""
    if not F.size or not len(rows):
        return F
    _, spread, basis = np.linalg.svd(F[rows])
    rank = int((spread > KNOWN * np.abs(F).max()).sum())
    return np.asarray(F @ basis[rank:].T)


def _regulator(plant: DelayedPlant, memory: int) -> tuple[Array, Array]:
    """Return the regulator's cost-to-go S on the stacked state and K'(Xi_u + B'SB)K, by value iteration: Xi_u may be zero."""
    A, B, Q, R = plant.matrices(memory)
    S = Q
    for _ in range(100_000):
        core = R + B.T @ S @ B
        price = A.T @ S @ B @ np.linalg.pinv(core, hermitian=True) @ B.T @ S @ A
        new = Q + A.T @ S @ A - price
        new = 0.5 * (new + new.T)
        if np.abs(new - S).max() <= 1e-13 * np.abs(new).max():
            return np.asarray(new), np.asarray(price)
        S = new
    raise Infeasible("the regulator's Riccati equation has no solution: the plant cannot be stabilised")


SLOTS = 5000
SETTLED = 1e-10


class CostMoments(NamedTuple):
    """Of the cost of a run: its mean and its variance."""

    mean: float
    variance: float


def cost_moments(loop: LiftedLoop, x0: npt.ArrayLike, phases: Array) -> CostMoments:
    r"""Return mean and variance of the cost over all paths, from a known past.

    They are exact, by fourth moments.

    A run costs J = sum of X(k)'Q X(k). With S the cost-to-go, J less its mean is the sum of the increments

    .. math:: D(k) = Y^T \Big(S_j - \sum_l p_{il} S_l\Big) Y, \qquad Y = L_i X(k),\ i = i(k),\ j = i(k+1),

    each of mean zero given the past, hence uncorrelated. So Var J is the sum over k of E D(k)^2, and that of the first phase:
    a quartic form of X(k), whose fourth moments follow the linear recursion

    .. math:: Z_j(k+1) = \sum_i p_{ij} (L_i \otimes L_i) Z_i(k) (L_i \otimes L_i)^T,
        \qquad Z_i = E[(X \otimes X)(X \otimes X)^T; i]

    on the symmetric part of X x X, N (N + 1) / 2 numbers. The sum ends where the loop is stable in the fourth moment: after as
    many slots as there are phases, so that chance has its turn, that add nothing.

    Args:
        loop: the lifted loop of order N; it takes N^4 numbers a phase.
        x0: x(0), (n,), or x(0), x(-1), ..., (h, n); zero before.
        phases: probability of each phase in slot 0.

    Raises:
        NotStable: the mean or the variance is infinite.
    """
    x, size, P = np.asarray(x0, dtype=float), loop.L.shape[-1], loop.transition
    S = loop.cost_to_go()
    X = np.zeros(size)
    X[: x.size] = x.ravel()
    first = np.einsum("a,iab,b->i", X, S, X)
    mean = float(phases @ first)
    upper = np.triu_indices(size)
    L2 = np.array([power(L, 2).toarray() for L in loop.L])
    later = np.tensordot(P, S, axes=1)
    forms = [[_form(L.T @ (S[j] - later[i]) @ L, upper) for j in range(len(S))] for i, L in enumerate(loop.L)]
    price = np.array([sum(p * np.outer(f, f) for p, f in zip(P[i], forms[i])) for i in range(len(S))])
    z = X[upper[0]] * X[upper[1]]
    Z = phases[:, None, None] * np.outer(z, z)
    variance, idle = float(phases @ (first - mean) ** 2), 0
    for _ in range(SLOTS):
        added = float(np.vdot(price, Z))
        variance += added
        if not np.isfinite(variance):
            break
        idle = idle + 1 if added <= SETTLED * variance else 0
        if idle >= len(P):
            return CostMoments(mean, variance)
        Z = np.tensordot(P.T, L2 @ Z @ L2.transpose(0, 2, 1), axes=1)
    raise NotStable("the variance of the cost has no finite sum: the loop is not stable in the fourth moment")


def _form(M: Array, upper: tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]) -> Array:
    """Return f with f'z = x'Mx for the products z = (x_a x_b), a <= b; M symmetric."""
    a, b = upper
    return np.asarray(M[upper] * np.where(a == b, 1.0, 2.0))
