"""Random loops of Chapters 2 and 4: state feedback by mode over a plant that jumps, and their exact second moments."""

from __future__ import annotations

from itertools import product
from typing import Any

import msgspec
import numpy as np
from scipy.linalg import expm

from design.controllers.scheduled_gain import ScheduledGain
from design.processes.delay_chain import DelayChain
from design.requests.scheduled import scheduled_of
from hil.certify import CertificationProblem
from plants import JumpModel, JumpRates, TransitionRates
from tests.hil.compose.random_loops import Array, chain, held, jump_loop, jump_matrices, radius, rates_of, rows


def sampled_radius(A: Array, B: Array, K: Array, generator: Array, T: float, late: int) -> float:
    """Exact radius per period with constant rates and K by the mode at the sample; ``late`` inputs are on their way."""
    modes, n, m = B.shape
    size = n + m
    # second moments of [x; u] within the period, coupled by the jumps
    coupled = np.kron(generator.T, np.eye(size * size))
    for i in range(modes):
        block = slice(i * size * size, (i + 1) * size * size)
        H = held(A[i], B[i])
        coupled[block, block] += np.kron(H, np.eye(size)) + np.kron(np.eye(size), H)
    # E over the jumps of Phi (x) Phi, from mode j to mode i, on [x; u]; inputs on the way are not touched by it
    within = expm(coupled * T).reshape(modes, size, size, modes, size, size)
    whole = n + m * (late + 1)
    # first moments of the flow couple what moves with what waits
    drift = np.kron(generator.T, np.eye(size))
    for i in range(modes):
        drift[i * size : (i + 1) * size, i * size : (i + 1) * size] += held(A[i], B[i])
    first = expm(drift * T).reshape(modes, size, modes, size)
    stay = expm(generator.T * T)

    def move(M: Array) -> Array:
        new = np.empty_like(M)
        for i in range(modes):  # the sample: its input joins the end of the queue, and the first of the queue acts
            queue = np.zeros((m * (late + 1), whole))
            if late:
                queue[: m * late, n + m :] = np.eye(m * late)
            queue[m * late :, :n] = K[i]
            S = np.vstack([np.eye(n, whole), queue])
            new[i] = S @ M[i] @ S.T
        out = np.zeros_like(M)
        out[:, :size, :size] = np.einsum("iabjcd,jcd->iab", within, new[:, :size, :size])
        out[:, :size, size:] = np.einsum("iajb,jbc->iac", first, new[:, :size, size:])
        out[:, size:, :size] = out[:, :size, size:].transpose(0, 2, 1)
        out[:, size:, size:] = np.einsum("ij,jab->iab", stay, new[:, size:, size:])
        return out

    return radius(move, np.broadcast_to(np.eye(whole), (modes, whole, whole)).copy())


def jump_case(rng: np.random.Generator, *, uncertain: bool = False) -> tuple[CertificationProblem, float]:
    modes, n, late = int(rng.integers(2, 5)), int(rng.integers(1, 5)), int(rng.integers(0, 3))
    if uncertain:
        modes, n, late = 2, min(n, 3), min(late, 1)
    A, B, K = jump_matrices(rng, modes, n)
    Q, T = rates_of(rng, modes), float(rng.choice([0.01, 0.05, 0.2]))
    table = TransitionRates(nodes_s=(0.0,), rates=(rows(Q),))
    changes: Any = ()
    corners = [A]
    if uncertain:
        by = rng.normal(scale=float(rng.choice([0.02, 0.1])), size=A.shape)
        changes = tuple((tuple(map(rows, sign * by)), tuple(map(rows, 0.0 * B))) for sign in (-1.0, 1.0))
        corners = [A, A - by, A + by]
    system = JumpModel(A=tuple(map(rows, A)), B=tuple(map(rows, B)), changes=changes)
    worst = max(sampled_radius(corner, B, K, Q, T, late) for corner in corners)
    return jump_loop(rng, system, JumpRates(rates=table), K, T, late), worst


def uncertain_case(rng: np.random.Generator) -> tuple[CertificationProblem, float]:
    return jump_case(rng, uncertain=True)


def fault_case(rng: np.random.Generator) -> tuple[CertificationProblem, float]:
    n, late, T = int(rng.integers(1, 5)), int(rng.integers(0, 2)), float(rng.choice([0.01, 0.05]))
    A, B, K = jump_matrices(rng, 2, n)
    failure, seen = rates_of(rng, 2), [rates_of(rng, 2) for _ in range(2)]
    tables = [TransitionRates(nodes_s=(0.0,), rates=(rows(Q),)) for Q in (failure, *seen)]
    system = JumpModel(
        A=tuple(map(rows, A)), B=tuple(map(rows, B)), E=(rows(np.ones((n, 1))),) * 2, C=(rows(np.ones((1, n))),) * 2
    )
    process = JumpRates(rates=tables[0], detection=tuple(tables[1:]))
    Q = np.kron(failure, np.eye(2)) + np.kron(np.diag([1.0, 0.0]), seen[0]) + np.kron(np.diag([0.0, 1.0]), seen[1])
    exact = sampled_radius(A[[0, 0, 1, 1]], B[[0, 0, 1, 1]], K[[0, 1, 0, 1]], Q, T, late)
    return jump_loop(rng, system, process, K, T, late), exact


# Random delays over a plant that jumps


def random_delay_radius(A: Array, B: Array, K: Array, generator: Array, T: float, sc: Array, ca: Array) -> float:
    """Exact radius per period: samples and what tau was in the state and the mode, no queue of inputs as the door has."""
    modes, n, m = B.shape
    taus, ds = len(sc), len(ca)
    depth, size = taus + ds - 2, n + m
    coupled, drift = np.kron(generator.T, np.eye(size * size)), np.kron(generator.T, np.eye(size))
    for i in range(modes):
        H, block, line = held(A[i], B[i]), slice(i * size**2, (i + 1) * size**2), slice(i * size, (i + 1) * size)
        coupled[block, block] += np.kron(H, np.eye(size)) + np.kron(np.eye(size), H)
        drift[line, line] += H
    within = expm(coupled * T).reshape(modes, size, size, modes, size, size)[:, :n, :n]
    first, stay = expm(drift * T).reshape(modes, size, modes, size)[:, :n], expm(generator.T * T)
    labels = list(product(product(range(modes), repeat=depth + 1), product(range(taus), repeat=ds), range(ds)))
    index = {label: k for k, label in enumerate(labels)}
    whole = n * (depth + 1)

    def move(M: Array) -> Array:
        out = np.zeros_like(M)
        for (seen, past, d), k in index.items():
            age = d + past[d]
            S = np.zeros((size + n * depth, whole))
            S[:n, :n], S[size:, : n * depth] = np.eye(n), np.eye(n * depth)
            S[n:size, n * age : n * (age + 1)] = K[seen[age]]
            Z = S @ M[k] @ S.T
            for end in range(modes):
                after = np.empty((whole, whole))
                after[:n, :n] = np.einsum("abcd,cd->ab", within[end, :, :, seen[0]], Z[:size, :size])
                after[:n, n:] = first[end, :, seen[0]] @ Z[:size, size:]
                after[n:, :n] = after[:n, n:].T
                after[n:, n:] = stay[end, seen[0]] * Z[size:, size:]
                for t, e in product(range(taus), range(ds)):
                    to = index[((end, *seen)[: depth + 1], (t, *past)[:ds], e)]
                    out[to] += sc[past[0], t] * ca[d, e] * after
        return out

    return radius(move, np.broadcast_to(np.eye(whole), (len(labels), whole, whole)).copy())


def network_case(rng: np.random.Generator) -> tuple[CertificationProblem, float]:
    n, (taus, ds) = int(rng.integers(1, 3)), ((2, 1), (1, 2), (2, 2), (3, 1))[int(rng.integers(0, 4))]
    A, B, K = jump_matrices(rng, 2, n)
    Q, T = rates_of(rng, 2), float(rng.choice([0.05, 0.2]))
    sc, ca = chain(rng, taus), chain(rng, ds)
    system = JumpModel(A=tuple(map(rows, A)), B=tuple(map(rows, B)))
    loop = jump_loop(rng, system, JumpRates(rates=TransitionRates(nodes_s=(0.0,), rates=(rows(Q),))), K, T, 0)
    over = msgspec.structs.replace(loop, sc=DelayChain(transition=sc), ca=DelayChain(transition=ca))
    return over, random_delay_radius(A, B, K, Q, T, sc, ca)


# Gains that change with the time in the mode


def sectioned_radius(A: Array, B: Array, K: Array, counts: list[int], generator: Array, T: float) -> float:
    """Exact radius per period: K[i, b] from the count of samples counts[b] on; the count goes on where no change is seen."""
    modes, n, m = B.shape
    size, last = n + m, counts[-1]
    coupled = np.kron(generator.T, np.eye(size * size))
    for i in range(modes):
        block, H = slice(i * size**2, (i + 1) * size**2), held(A[i], B[i])
        coupled[block, block] += np.kron(H, np.eye(size)) + np.kron(np.eye(size), H)
    within = expm(coupled * T).reshape(modes, size, size, modes, size, size)[:, :n, :n]

    def move(M: Array) -> Array:
        out, old = np.zeros_like(M), M.reshape(modes, last + 1, n, n)
        new = out.reshape(old.shape)
        for i, c in product(range(modes), range(last + 1)):
            S = np.vstack([np.eye(n), K[i, np.searchsorted(counts, c, side="right") - 1]])
            after = np.einsum("iabcd,cd->iab", within[:, :, :, i], S @ old[i, c] @ S.T)
            for end in range(modes):
                new[end, min(c + 1, last) if end == i else 0] += after[end]
        return out

    return radius(move, np.broadcast_to(np.eye(n), (modes * (last + 1), n, n)).copy())


def sectioned_case(rng: np.random.Generator) -> tuple[CertificationProblem, float]:
    modes, n = int(rng.integers(2, 4)), int(rng.integers(1, 4))
    A, B, K = jump_matrices(rng, modes, n)
    Q, T = rates_of(rng, modes), float(rng.choice([0.05, 0.2]))
    counts = [0, *np.cumsum(rng.integers(1, 6, 2)).tolist()]
    by_age = K[:, None] * rng.uniform(-0.4, 1.8, (modes, 3, 1, 1))
    system = JumpModel(A=tuple(map(rows, A)), B=tuple(map(rows, B)))
    loop = jump_loop(rng, system, JumpRates(rates=TransitionRates(nodes_s=(0.0,), rates=(rows(Q),))), K, T, 0)
    starts = np.tile([0.0, *((c - 0.5) * T for c in counts[1:])], (modes, 1))
    controller = scheduled_of(ScheduledGain(gain=by_age, starts_s=starts))
    return msgspec.structs.replace(loop, controller=controller), sectioned_radius(A, B, by_age, counts, Q, T)
