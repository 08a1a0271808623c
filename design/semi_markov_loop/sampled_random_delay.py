"""A sampled jump loop over random delays: the plant's modes times the modes of both delay chains, a jump-linear system.

    u_k = K(r_k-tau) x_k-tau computed in slot k,    v_k-d acts over [k T, (k + 1) T),    tau, d: modes of two Markov chains

With xi = (x_k, ..., x_k-taumax, v_k-1, ..., v_k-dmax) and the label (mode of the plant, modes seen before, modes of both
chains), the second moments of a period are R, positive: a sample (a congruence), the flow with its jumps (the exponential of
the moment equation at constant rates), the next modes of the chains. Where a rate or a probability is known by its bounds
only, R is taken with more jumps and less staying, or with less and more, which bounds the true map. With rho just above the
radius of the larger R,

    X = (rho I - R)^-1 I,    X > 0,    R X <= rho X,

is checked by eigenvalues and proves that the radius is at most rho.

Reference: thesis (2.1), (7.14); Collatz and Wielandt.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
from msgspec import Struct
from scipy.sparse.linalg import ArpackError, eigs

from design.controllers.scheduled_gain import ScheduledGain
from design.processes.delay_chain import DelayChain
from design.processes.semi_markov import FaultDetection, SemiMarkov
from design.semi_markov_loop import FloatArray, JumpSystem
from design.semi_markov_loop.period_moments import (
    Box,
    TooLarge,
    congruence,
    gain_mode,
    growth_bound,
    pair_box,
    period_flows,
    svec,
    svec_size,
)
from design.verdict import State, Verdict

LARGEST = 2000
"""Most unknowns of R."""
RESTARTS = 60
"""Of ARPACK; then all eigenvalues are computed."""
TOLERANCE = 1e-6
"""How far from 1 a radius must lie to decide."""
METHOD = "sampled jump loop: plant times network as a jump-linear system"
ASSUMED = ("the rates are as given, within their own bounds", "the periods are exact", "no packet is later than its law says")


class RandomDelayLoop(Struct, frozen=True, kw_only=True, eq=False):
    """Matrices, rates and gain of every mode, and the delay chains.

    Args:
        system: certain matrices of every mode (of Chapter 4: of every pair of fault and detected mode).
        boxes: per mode, bounds of the rates out of it at any age.
        gains: K of every mode that is seen, shape (R, m, n).
        seen: per mode, which of them the controller sees.
        period_s: T (s).
        tau, d: the chains of both delays.
    """

    system: JumpSystem
    boxes: Sequence[Box]
    gains: FloatArray
    seen: Sequence[int]
    period_s: float
    tau: DelayChain
    d: DelayChain

    @property
    def size(self) -> int:
        """Length of xi."""
        return self.system.states * (self.tau.max_delay + 1) + self.system.inputs * self.d.max_delay

    @property
    def labels(self) -> list[tuple[int, ...]]:
        """(mode, seen in the taumax slots before, mode of the S-C chain, mode of the C-A chain)."""
        before = [range(self.gains.shape[0])] * self.tau.max_delay
        return list(itertools.product(range(self.system.modes), *before, range(self.tau.modes), range(self.d.modes)))

    def sampled(self, label: tuple[int, ...]) -> FloatArray:
        """The map from xi to (xi shifted by one period, v_k-d), x_k standing for x_k+1 until it has moved."""
        n, m, size = self.system.states, self.system.inputs, self.size
        late, late_d = self.tau.max_delay, self.d.max_delay
        history = (self.seen[label[0]], *label[1 : 1 + late])
        tau, d = int(self.tau.delay[label[-2]]), int(self.d.delay[label[-1]])
        fresh = np.zeros((m, size))
        fresh[:, n * tau : n * (tau + 1)] = self.gains[history[tau]]
        queue = np.vstack([fresh, np.eye(size)[n * (late + 1) :]])  # v_k, v_k-1, ..., v_k-dmax
        states = np.eye(size)[: n * (late + 1)]
        shifted = np.vstack([states[:n], states[: n * late], queue[: m * late_d]])
        return np.vstack([shifted, queue[m * d : m * (d + 1)]])


def moment_matrix(loop: RandomDelayLoop, *, upper: bool) -> FloatArray:
    """R of the module's docstring, shape (labels p, labels p).

    Raises:
        TooLarge: more than ``LARGEST`` unknowns.
    """
    labels, p = loop.labels, svec_size(loop.size)
    if len(labels) * p > LARGEST:
        raise TooLarge(
            f"random delays over a plant that jumps: {len(labels)} modes of plant and network, {loop.size} states with delayed "
            f"ones: {len(labels) * p} second moments, at most {LARGEST}"
        )
    size = loop.size + loop.system.inputs
    if loop.system.modes * svec_size(size) > 1500:
        raise TooLarge(f"{loop.system.modes} modes of the plant and {size} states with delayed ones are too many")
    flows, index = period_flows(loop.system, loop.boxes, loop.period_s, size, upper), {label: k for k, label in enumerate(labels)}
    chains = [chain.bounds[int(upper)] for chain in (loop.tau, loop.d)]
    late, keep = loop.tau.max_delay, congruence(np.eye(loop.size, size))
    out = np.zeros((len(labels), p, len(labels), p))
    for label, at in index.items():
        lift = congruence(loop.sampled(label))
        history = (loop.seen[label[0]], *label[1 : 1 + late])[:late]
        moved = [keep @ flows[end, :, label[0], :] @ lift for end in range(loop.system.modes)]
        for (end, after), (sc, a), (ca, b) in itertools.product(
            enumerate(moved), enumerate(chains[0][label[-2]]), enumerate(chains[1][label[-1]])
        ):
            if a * b > 0.0:
                out[index[end, *history, sc, ca], :, at, :] += a * b * after
    return out.reshape(len(labels) * p, -1)


def radius(matrix: FloatArray) -> float:
    """The spectral radius of R."""
    if matrix.shape[0] > 300:
        try:
            found = eigs(matrix, k=1, tol=1e-10, maxiter=RESTARTS, v0=np.ones(matrix.shape[0]), return_eigenvectors=False)
            return float(np.abs(found[0]))
        except ArpackError:
            pass
    return float(np.abs(np.linalg.eigvals(matrix)).max())


def proved_radius(matrix: FloatArray, labels: int, guess: float) -> float:
    """An upper bound of the spectral radius of R below 1, checked by eigenvalues; ``inf`` where none is found."""
    rho = min(1.001 * guess, 0.5 * (1.0 + guess))
    if not rho < 1.0:
        return math.inf
    p = matrix.shape[0] // labels
    unit = np.tile(svec(np.eye(round((math.sqrt(8 * p + 1) - 1) / 2))), labels)
    X = np.asarray(np.linalg.solve(rho * np.eye(matrix.shape[0]) - matrix, unit), dtype=np.float64)
    try:
        bound = growth_bound(X.reshape(labels, p), (matrix @ X).reshape(labels, p))
    except np.linalg.LinAlgError:  # X > 0 does not hold
        return math.inf
    return bound if bound < 1.0 else math.inf


def random_delay_verdict(
    system: JumpSystem,
    process: SemiMarkov | FaultDetection,
    gain: ScheduledGain,
    period_s: float,
    tau: DelayChain,
    d: DelayChain,
) -> Verdict:
    """Return whether the loop is mean-square stable over two delay chains; the digest is left empty.

    Exact where the rates are constant; where they change with age it is decided if both sides agree, and undecided with both
    numbers if not.

    Raises:
        TooLarge: more unknowns than are computed with.
    """
    rows, seen, boxes = _modes(system.modes, process, gain)
    plant = JumpSystem(a=system.a[rows], b=system.b[rows])
    loop = RandomDelayLoop(system=plant, boxes=boxes, gains=gain.gain[:, 0], seen=seen, period_s=period_s, tau=tau, d=d)
    larger, smaller = moment_matrix(loop, upper=True), moment_matrix(loop, upper=False)
    upper = proved_radius(larger, len(loop.labels), radius(larger))
    lower = radius(smaller)
    state: State = "undecided"
    what = f"in the long run second moments are multiplied by at least {lower:.6g} per period, and no bound below 1 is proved"
    if upper < 1.0 - TOLERANCE:
        state, what = "certified", f"in the long run second moments are multiplied by at most {upper:.6g} per period"
    elif lower > 1.0 + TOLERANCE:
        state, what = "refused", f"in the long run second moments are multiplied by at least {lower:.6g} per period"
    return Verdict(
        kind="mean-square stability", state=state, number=upper if state == "certified" else lower, limit=1.0,
        reason=f"{what} over {len(loop.labels)} modes of plant and network",
        quantity="spectral radius of the second moments per period", assumptions=ASSUMED, method=METHOD,
    )  # fmt: skip


def _modes(modes: int, process: SemiMarkov | FaultDetection, gain: ScheduledGain) -> tuple[list[int], list[int], list[Box]]:
    # per mode of the product: the matrices, the gain that the controller picks, and the rates by the mode that they lead to
    if isinstance(process, SemiMarkov):
        bounds = [process.bounds(i, 0.0, math.inf) for i in range(modes)]
        return list(range(modes)), list(range(modes)), [Box(low=low, high=high) for low, high in bounds]
    pairs = list(itertools.product(range(modes), range(process.detection[0].modes)))
    gains = [gain_mode(gain.measured, process, i, k) for i, k in pairs]
    return [i for i, _ in pairs], gains, [pair_box(process, i, k) for i, k in pairs]
