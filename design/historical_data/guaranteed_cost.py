r"""What scheduled gains cost: from a state or on average, beside what sensor noise adds.

.. math:: J = E \sum_k x(k)^T \Xi x(k) + u(k)^T \Xi_u u(k) = \sum_i \operatorname{tr}(S_i W_i)

S is the cost-to-go of the lifted loop and W_i = Pr(phase i at 0) E X(0) X(0)'.

What the controller received is not what the plant was: every sample carries one draw v_l(k), which a buffer sends again with the
sample; before slot 0 nothing was received. With Y(k) = (y(k), ..., y(k - tau)), y(k) = x(k) + v(k) from slot 0 on and 0 before,
the pair (X, Y) is jump-linear:

.. math:: X(k+1) = \tilde A X(k) + \tilde B K_i Y(k), \qquad P_j(k+1) = \sum_i p_{ij} Fi P_i(k) Fi^T + \pi_j(k+1) W

DEVIATION: Theorem 5.1 bounds J by a functional that is block diagonal in the past; its conditions are infeasible on the chapter's
own example (see `design.as_printed.chapters_5_and_6`). The Lyapunov equation on the stacked state is necessary and sufficient.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from msgspec import Struct

from design.errors import NotStable
from design.historical_data import Array, DelayedPlant, LiftedLoop, close, cycle, with_held
from design.verdict import Verdict

Renewed = npt.NDArray[np.bool_] | None
Ages = npt.NDArray[np.int64] | None


class Start(Struct, frozen=True, kw_only=True, eq=False):
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

    def mean(self, S: Array) -> float:
        """Return E X(0)' S_i X(0) of a cost-to-go S, (phases, N, N)."""
        return float(np.einsum("iab,iab->", S, self.lifted(S.shape[-1])))


def average_start(states: int, phases: int) -> Start:
    """Return the mean cost: x(0) ~ N(0, I), every phase equally likely."""
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
    return start.mean(loop.cost_to_go())


def certify_cost(
    plant: DelayedPlant,
    gains: Array,
    start: Start,
    transition: Array | None = None,
    *,
    history: Array | None = None,
    deviation: Array | None = None,
    renewed: Renewed = None,
    ages: Ages = None,
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
        renewed: (phases, n), as of `design.historical_data.close`; the gains then have a column more.
        ages: (phases,), as of `design.historical_data.close`.
    """
    loop = close(plant, gains, transition, renewed=renewed, ages=ages)
    past, noisy = history is not None and bool(np.any(history[1:])), deviation is not None and bool(np.any(deviation))
    radius = loop.radius()
    margin = 64 * loop.L.shape[-1] * float(np.finfo(float).eps)
    stable = radius < 1.0 - margin
    details: dict[str, object] = {"phases": len(gains), "order": loop.L.shape[-1]}
    if stable:
        try:
            S = loop.stable_cost_to_go()
            details["cost"] = start.mean(S)
            details["residual"] = _residual(loop, S)
            if history is not None:
                run, first = run_from(plant, gains, history, transition, renewed, ages)
                details["cost"] = Start(moment=np.outer(first, first), phases=start.phases).mean(run.stable_cost_to_go())
            if noisy and deviation is not None:
                details["noise_cost_per_slot"] = stationary_cost(plant, gains, deviation, transition, start.phases, renewed, ages)
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
            "the phases follow the cycle" if transition is None else "the phases follow the chain",
        ),
        method="Lyapunov equation on the stacked state, exact", details=details,
    )  # fmt: skip


def _residual(loop: LiftedLoop, S: Array) -> float:
    expected = np.einsum("ij,jab->iab", loop.transition, S)
    gap = loop.Q + loop.L.transpose(0, 2, 1) @ expected @ loop.L - S
    return float(np.abs(gap).max() / np.abs(S).max())


def close_received(
    plant: DelayedPlant, gains: Array, transition: Array | None = None, renewed: Renewed = None, ages: Ages = None
) -> LiftedLoop:
    """Return the loop on (X, Y), with u = K Y, or on (X, Y, h), with u = K (Y, h).

    Args:
        plant: the plant and its weights.
        gains: (phases, memory + 1, p, n).
        transition: chain of the phases; default the cycle.
        renewed, ages: as of `design.historical_data.close`.
    """
    phases, columns, p, n = gains.shape
    K = gains.transpose(0, 2, 1, 3).reshape(phases, p, columns * n)
    columns -= renewed is not None
    memory = max(columns - 1, plant.memory)
    A, B, weight, input_weight = plant.matrices(memory)
    if ages is not None:
        A, B, weight, under_way, at_once = plant.with_ages(memory, ages)
    size, received = A.shape[-1], columns * n
    F = np.zeros((phases, size + received, size + received))
    F[:, size + n :, size:-n] = np.eye(received - n)
    if renewed is not None:
        F = with_held(F[0], renewed, size + received - n)
    Q = np.zeros_like(F)
    F[:, :size, :size], F[:, :size, size:] = A, B @ K
    F[:, size : size + n] = F[:, :n]
    Q[:, :size, :size], Q[:, size:, size:] = weight, K.transpose(0, 2, 1) @ input_weight @ K
    if ages is not None:
        acts = np.concatenate([under_way, at_once @ K], axis=2)
        Q[:, size:, size:] = 0.0
        Q += acts.transpose(0, 2, 1) @ input_weight @ acts
    return LiftedLoop(L=F, Q=Q, transition=cycle(phases) if transition is None else np.asarray(transition, dtype=float))


def run_from(
    plant: DelayedPlant, gains: Array, history: npt.ArrayLike, transition: Array | None = None, renewed: Renewed = None,
    ages: Ages = None,
) -> tuple[LiftedLoop, Array]:  # fmt: skip
    """Return the loop of `close_received` and (X, Y) in slot 0, from a history that acts on the plant and was not received.

    Args:
        plant: the plant and its weights.
        gains: (phases, memory + 1, p, n).
        history: x(0), x(-1), ..., at most as many as the plant has delayed states and one, (h, n).
        transition: chain of the phases; default the cycle.
        renewed, ages: as of `design.historical_data.close`.
    """
    loop, known = close_received(plant, gains, transition, renewed, ages), np.asarray(history, dtype=float)
    size, n = loop.L.shape[-1] - gains.shape[1] * gains.shape[3], known.shape[1]
    start = np.zeros(loop.L.shape[-1])
    start[: known.size], start[size : size + n] = known.ravel(), known[0]
    return loop, start


def stationary_cost(
    plant: DelayedPlant,
    gains: Array,
    deviation: npt.ArrayLike,
    transition: Array | None = None,
    phases: Array | None = None,
    renewed: Renewed = None,
    ages: Ages = None,
) -> float:
    """Return E x' Xi x + u' Xi_u u per slot, in the mean over time, once the start is forgotten.

    The covariance of (X, Y) is the sum of what the draws of all slots so far have come to.

    Args:
        plant: the plant and its weights.
        gains: (phases, memory + 1, p, n).
        deviation: standard deviation of the noise, one number or one for each state, in its unit; independent over slots.
        transition: chain of the phases; default the cycle.
        phases: probability of each phase in slot 0, for a chain that does not forget it; default uniform.
        renewed, ages: as of `design.historical_data.close`.

    Raises:
        NotStable: the covariance grows without end.
    """
    if close(plant, gains, transition, renewed=renewed, ages=ages).radius() >= 1.0:
        raise NotStable("the noise has no stationary covariance: the loop is not stable")
    loop, count, n = close_received(plant, gains, transition, renewed, ages), len(gains), len(plant.A)
    start = np.full(count, 1.0 / count) if phases is None else np.asarray(phases, dtype=float)
    share = start @ np.linalg.matrix_power(0.5 * (np.eye(count) + loop.transition), 2**20)  # a lazy chain has the same mean
    first = loop.L.shape[-1] - gains.shape[1] * n  # of Y
    fresh = np.zeros_like(loop.L)
    fresh[:, range(first, first + n), range(first, first + n)] = np.asarray(deviation, dtype=float) ** 2
    return float(np.einsum("iab,iab->", loop.Q, loop.gramian((share / share.sum())[:, None, None] * fresh)))
