"""Random loops of Chapter 7: tables of gains over two delay chains, and their exact second moments."""

from __future__ import annotations

from itertools import product

import msgspec
import numpy as np
from scipy.linalg import solve_discrete_are

from design.controllers import LoopModel, SendAll, nested
from design.processes.delay_chain import DelayChain
from hil.certify import CertificationProblem
from hil.rig.delay_chains import delay_chain
from tests.hil.compose.random_loops import Array, Flat, chain, radius
from transport.laws.semi_markov import SemiMarkovAge
from transport.laws.sojourn import Table


def send_all_draw(rng: np.random.Generator, taus: int, ds: int) -> tuple[CertificationProblem, Array]:
    n = int(rng.integers(1, 5))
    A = rng.normal(size=(n, n))
    A *= rng.uniform(0.8, 1.5) / max(abs(np.linalg.eigvals(A)))
    B, C = rng.normal(size=(n, 1)), np.eye(n)
    local = -np.linalg.solve(1.0 + B.T @ (P := solve_discrete_are(A, B, C.T @ C, np.eye(1))) @ B, B.T @ P @ A)
    K = local * rng.uniform(0.2, 1.6, (taus, ds, 1, 1))
    A = A + rng.normal(scale=0.08, size=A.shape)  # the plant is another than the gains were made for
    sc, ca = chain(rng, taus), chain(rng, ds)
    model = LoopModel(A=A, B=B, C=C, period_s=0.1, tau_max=taus - 1, d_max=ds - 1)
    loop = CertificationProblem(
        plant=Flat(), controller=SendAll(gains=nested(K)), model=model, sc=DelayChain(transition=sc),
        ca=DelayChain(transition=ca), digest="study",
    )  # fmt: skip
    return loop, K


def send_all_radius(A: Array, B: Array, K: Array, sc: Array, tau_of: list[int], ca: Array) -> float:
    """Exact radius: whole packets in the state, [x(k), ..., x(k - taus + 1), packet(k - 1), ...]; a packet has ds rows."""
    n, (taus, ds) = len(A), K.shape[:2]
    size = n * taus + ds * (ds - 1)
    moves = np.zeros((taus, ds, size, size))
    for tau in range(taus):
        for d in range(ds):
            F = moves[tau, d]
            new = np.zeros((ds, size))
            for row in range(ds):
                new[row, n * tau : n * (tau + 1)] = K[tau, row, 0]
            packets = [new, *(np.eye(size)[n * taus + ds * g : n * taus + ds * (g + 1)] for g in range(ds - 1))]
            F[:n, :n] = A
            F[:n] += B @ packets[d][d : d + 1]
            F[n : n * taus, : n * (taus - 1)] = np.eye(n * (taus - 1))
            for g in range(ds - 1):
                F[n * taus + ds * g : n * taus + ds * (g + 1)] = packets[g]
    joint = np.kron(sc, ca)
    F = moves[tau_of].reshape(-1, size, size)
    start = np.broadcast_to(np.eye(size), F.shape).copy()
    return radius(lambda M: np.einsum("ji,jab->iab", joint, F @ M @ F.transpose(0, 2, 1)), start)


def send_all_case(rng: np.random.Generator) -> tuple[CertificationProblem, float]:
    taus, ds = int(rng.integers(1, 4)), int(rng.integers(1, 3))
    loop, K = send_all_draw(rng, taus, ds)
    assert loop.sc is not None and loop.ca is not None
    return loop, send_all_radius(loop.model.A, loop.model.B, K, loop.sc.matrix, list(range(taus)), loop.ca.matrix)


def sojourn_case(rng: np.random.Generator) -> tuple[CertificationProblem, float]:
    """A semi-Markov network law; the reference counts the slots that a stay still has, where the door counts those it had."""
    loop, K = send_all_draw(rng, 2, int(rng.integers(1, 3)))
    longest = 5
    lasts = rng.dirichlet(np.full(longest, 0.4), 2)
    law = SemiMarkovAge(matrix=((0.0, 1.0), (1.0, 0.0)), sojourn=tuple(Table(probabilities=tuple(p / p.sum())) for p in lasts))
    left = np.zeros((2 * longest, 2 * longest))
    for mode, rest in product(range(2), range(longest)):
        if rest:
            left[mode * longest + rest, mode * longest + rest - 1] = 1.0
        else:
            left[mode * longest, (1 - mode) * longest : (2 - mode) * longest] = lasts[1 - mode]
    assert loop.ca is not None
    over = msgspec.structs.replace(loop, sc=delay_chain(law))
    return over, send_all_radius(loop.model.A, loop.model.B, K, left, [0] * longest + [1] * longest, loop.ca.matrix)
