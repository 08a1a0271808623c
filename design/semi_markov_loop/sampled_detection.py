"""The sampled loop of Chapter 4, its failure not seen and its detection late: a proof of its stability, and one of its growth.

Stability is proved by a Lyapunov function (`lyapunov_decrease`), growth by a quadratic form (`growth_while_it_stays`); the latter
refuses loops whose second moments are too large to compute. Either is checked by eigenvalues, whatever a solver says.

Reference: thesis (4.2), (4.14), sampled; Chetaev's theorem on instability.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from msgspec import Struct
from scipy.linalg import expm, solve_discrete_lyapunov

from design.controllers.scheduled_gain import ScheduledGain
from design.lmi.program import Array, LmiProgram, LmiSolution
from design.processes.semi_markov import FaultDetection, SemiMarkov
from design.semi_markov_loop import FloatArray, JumpSystem
from design.semi_markov_loop.period_moments import (
    Box,
    PeriodMoments,
    congruence,
    gain_mode,
    held_flow,
    isometry,
    pair_box,
    period_flows,
    period_moments,
    svec_size,
)
from design.semi_markov_loop.sojourn_renewal import SampledLoop, check_size, rates_by_age

CONDITION = 1e5
"""Largest condition number of P that is searched."""


class DetectionLoop(Struct, frozen=True, kw_only=True, eq=False):
    """The loop of Chapter 4 on pairs (eta, r), index eta N_r + r, with the gain of every pair.

    Args:
        pairs: matrices, gains (row of every pair), period and delays; its ``process`` is not used.
        process: both processes.
    """

    pairs: SampledLoop
    process: FaultDetection

    @classmethod
    def of(
        cls, system: JumpSystem, process: FaultDetection, gain: ScheduledGain, *, period_s: float, tau: int, d: int
    ) -> DetectionLoop:
        """The loop with the gains, held over their sections, that a controller has which sees ``gain.measured``."""
        seen = process.detection[0].modes
        both = list(itertools.product(range(system.modes), range(seen)))
        eta = [i for i, _ in both]
        rows = [gain_mode(gain.measured, process, i, k) for i, k in both]
        paired = JumpSystem(a=system.a[eta], b=system.b[eta])
        shown = np.array([system.shown(i) for i in eta])[:, None]  # of the instant of the sample, as r is
        table = replace(gain, gain=gain.gain[rows] @ shown, starts_s=gain.starts_s[rows])
        loop = SampledLoop(system=paired, process=process.failure, gain=table, period_s=period_s, tau=tau, d=d)
        check_size(loop)
        return cls(pairs=loop, process=process)

    @property
    def seen(self) -> int:
        """Number of detection modes."""
        return self.process.detection[0].modes

    def targets(self, pair: int) -> list[int]:
        """The pairs that one jump leads to."""
        i, k = divmod(pair, self.seen)
        return [j * self.seen + k for j in self.process.failure.targets(i)] + [
            i * self.seen + j for j in self.process.detection[i].targets(k)
        ]

    def box(self, pair: int, until_s: float) -> Box:
        """Bounds of the rates out of a pair while r is younger than ``until_s``, by the pair that they lead to."""
        return pair_box(self.process, *divmod(pair, self.seen), until_s)

    def first(self, pair: int) -> int:
        """The section of the gains at count 0."""
        return int(np.searchsorted(self.pairs.gain.starts_s[pair], self.pairs.tau * self.pairs.period_s, side="right")) - 1

    def variations(self) -> FloatArray:
        """The most that each rate out of each pair varies within two periods (1/s), (pairs, pairs)."""
        modes, T = self.process.failure.modes, self.pairs.period_s
        out = np.zeros((modes, self.seen, modes, self.seen))
        for i, detection in enumerate(self.process.detection):
            out[i, range(self.seen), :, range(self.seen)] += _variation(self.process.failure, i, T)
            for k in range(self.seen):
                out[i, k, i, :] += _variation(detection, k, T)
        return out.reshape(modes * self.seen, -1)


def _variation(process: SemiMarkov, mode: int, period_s: float) -> FloatArray:
    ages = rates_by_age(process, mode, period_s)
    after = np.minimum(np.arange(ages.end + 1) + 1, ages.end)  # of two cells at a time
    return np.asarray((np.maximum(ages.high, ages.high[after]) - np.minimum(ages.low, ages.low[after])).max(axis=0))


def slowest_growth(loop: DetectionLoop) -> float:
    """A lower bound of the growth of E|xi|^2 per period: of the paths on the last sections of the gains, at the least rates."""
    pairs = loop.pairs
    everywhere = [loop.box(pair, math.inf) for pair in range(pairs.system.modes)]
    size, p = pairs.size + pairs.system.inputs, svec_size(pairs.size)
    flows, keep = period_flows(pairs.system, everywhere, pairs.period_s, size, False), congruence(np.eye(pairs.size, size))
    out = np.zeros((pairs.system.modes, p, pairs.system.modes, p))
    for pair, end in itertools.product(range(pairs.system.modes), repeat=2):
        if end % loop.seen == pair % loop.seen or loop.first(end) + 1 == pairs.gain.starts_s.shape[1]:
            lift = congruence(pairs.sampled_at(pairs.gain.gain[pair, -1]))
            out[end, :, pair, :] = keep @ flows[end, :, pair, :] @ lift
    return float(np.abs(np.linalg.eigvals(out.reshape(pairs.system.modes * p, -1))).max())


def lyapunov_decrease(loop: DetectionLoop) -> LmiSolution:
    """Search P_ikb and check every inequality by its eigenvalues; all rates have finite bounds.

    The function has a clock for the failure and one for its detection:

        V = xi' P_ikb xi,    i = eta, k = r, b = the section of the gain that the count of samples in k selects,

    falls on average over one period, whatever the rates do within their bounds: with lambda_t any rate out of (i, k), mu_t its
    infimum over the period and delta_t the most that it varies within two periods,

        e^(-|mu| T) Psi' P_ikb Psi + sum_t (mu_t + delta_t) (landing at t and what follows within the period) - P_ikb < 0,

    convex in mu, so that it is checked at the corners of the bounds. P falls where the count enters a new section. Where r was
    left and entered again between two samples is not seen: the bounds of section b hold for every younger age too.

    Reference: thesis (4.2), (4.14), sampled.
    """
    pairs, T = loop.pairs, loop.pairs.period_s
    everywhere = [loop.box(pair, math.inf) for pair in range(pairs.system.modes)]
    maps = period_moments(pairs.system, everywhere, T, pairs.delay, True)
    program, delta = LmiProgram(reach=CONDITION), loop.variations()
    size = pairs.size
    for pair in range(pairs.system.modes):
        starts = pairs.gain.starts_s[pair]
        for b, stop in enumerate([*starts[1:].tolist(), math.inf]):
            name = f"P[{pair},{b}]"
            program.symmetric(name, size, least=1.0, most=CONDITION)
            box = loop.box(pair, stop + 2 * T)
            _require_decrease(program, loop, maps, pair, b, box, delta[pair])
            if b + 1 < starts.size:
                program.require(f"{name} falls", lambda p, q: q - p, name, f"P[{pair},{b + 1}]", strict=False)
    return program.solve()


def _require_decrease(
    program: LmiProgram, loop: DetectionLoop, maps: PeriodMoments, pair: int, section: int, box: Box, delta: FloatArray
) -> None:
    pairs, T = loop.pairs, loop.pairs.period_s
    sampled = pairs.sampled_at(pairs.gain.gain[pair, section])
    lift, own = congruence(sampled), f"P[{pair},{section}]"
    weights = maps.weights_s * np.exp(-float(box.low.sum()) * maps.nodes_s)
    basis = isometry(pairs.size)
    targets = loop.targets(pair)
    # seen to stay in r: the count goes on; seen to change: it starts anew. By the pair at the end of the period.
    ends = list(range(pairs.system.modes))
    landing = [own if j == pair else f"P[{j},{section if j % loop.seen == pair % loop.seen else loop.first(j)}]" for j in ends]
    leaps = np.tensordot(weights, maps.jumped[pair][targets], axes=(0, 2)) @ lift  # (targets, end pair, p, p)
    leaps, still = basis @ leaps @ basis.T, basis @ (maps.still[pair] @ lift) @ basis.T
    corners = itertools.product(*({float(box.low[t]), float(box.high[t])} for t in targets))
    for corner in corners:
        arriving = np.tensordot(np.array(corner) + delta[targets], leaps, axes=(0, 0))
        arriving[pair] += math.exp(-sum(corner) * T) * still
        function = partial(_change, arriving=arriving, period_s=T)
        program.require(f"decrease of {own} at rates {corner}", function, own, *landing)


def _change(own: Array, *after: Array, arriving: FloatArray, period_s: float) -> Array:
    n, value = own.shape[-1], -own
    for p, leap in zip(after, arriving):
        value = value + (p.reshape(*p.shape[:-2], 1, n * n) @ leap).reshape(p.shape)
    return np.asarray(value / period_s)


STATES = 500
"""Most states with delayed inputs for which W is computed."""
_MARGIN = 0.05
_LARGEST = 1e8
_SHARES = (0.9, 0.5, 0.1)
_INPUT_WEIGHTS = (1e-3, 1e-1)


def growth_while_it_stays(loop: SampledLoop, mode: int, gains: Sequence[FloatArray], exit_rate: float) -> float:
    """A lower bound of the growth of E|xi|^2 per period, 0 where none above 1 is proved.

    While the mode of the plant stays i, xi_k+1 = F_s xi_k, whichever gain K_s the controller holds. If a symmetric W, of any
    sign, and a rho > 1 fulfil

        F_s' W F_s - rho W > 0  for every gain,        x' W_xx x > 0  for some x,

    then xi_k' W xi_k >= rho^k xi_0' W xi_0 on those paths. Their probability is at least e^(-Lambda_i k T), Lambda_i the largest
    rate out of mode i at any sojourn time, so that E |xi_k|^2 grows at least like (rho e^(-Lambda_i T))^k.

    W solves F' W F - rho W = Q for the mean of the gains; it is checked for each of them by eigenvalues.

    Args:
        loop: matrices, period and delays.
        mode: i, the mode of the plant that stays.
        gains: every K_s that the controller may hold meanwhile, each of shape (m, n).
        exit_rate: Lambda_i (1/s).
    """
    if loop.size > STATES or not math.isfinite(exit_rate):
        return 0.0
    maps = [period_map(loop, mode, gain) for gain in gains]
    mean = period_map(loop, mode, np.mean(gains, axis=0))
    fastest, leave = float(np.abs(np.linalg.eigvals(mean)).max() ** 2), math.exp(exit_rate * loop.period_s)
    for share in _SHARES:
        rho = leave * (fastest / leave) ** share
        if rho <= leave:
            break
        if any(_grows(maps, mean, rho, loop.system.states, weight) for weight in _INPUT_WEIGHTS):
            return float(rho / leave)
    return 0.0


def period_map(loop: SampledLoop, mode: int, gain: FloatArray) -> FloatArray:
    """F, from xi = (x, v_-1, ..., v_-D) to xi one period later while the mode stays, shape (size, size)."""
    n, m, size = loop.system.states, loop.system.inputs, loop.size
    flow = expm(held_flow(loop.system.a[mode], loop.system.b[mode], n + m) * loop.period_s)
    out = np.zeros((size, size + m))
    out[:n, :n], out[:n, size:] = flow[:n, :n], flow[:n, n:]
    out[n:, n:size] = np.eye(size - n)
    return np.asarray(out @ loop.sampled_at(gain))


def _grows(maps: Sequence[FloatArray], mean: FloatArray, rho: float, states: int, input_weight: float) -> bool:
    weights = np.concatenate([np.ones(states), np.full(mean.shape[0] - states, input_weight)])
    scaled = mean.T / math.sqrt(rho)
    W = solve_discrete_lyapunov(scaled, -np.diag(weights) / rho, method="bilinear")
    if not np.isfinite(W).all() or np.abs(W).max() > _LARGEST:
        return False
    W = 0.5 * (W + W.T)
    unit = 1.0 / np.sqrt(weights)
    rises = [np.linalg.eigvalsh(unit[:, None] * (F.T @ W @ F - rho * W) * unit)[0] for F in maps]
    return bool(min(rises) > _MARGIN and np.linalg.eigvalsh(W[:states, :states])[-1] > _MARGIN)
