"""Random loops of Chapter 3: a delay inside a plant that jumps, and the radius with a delay that is constant by mode."""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm

from hil.certify import CertificationProblem
from plants import JumpModel, JumpRates, TransitionRates
from tests.hil.compose.random_jump_loops import sampled_radius
from tests.hil.compose.random_loops import Array, jump_loop, jump_matrices, radius, rates_of, rows


def delayed_radius(A: Array, Ad: Array, B: Array, K: Array, late: list[int], generator: Array, T: float, cut: int) -> float:
    """Radius per period with a constant delay of late[i] T / cut in mode i and jumps at the ends of sub-steps."""
    modes, n, m = B.shape
    h, depth = T / cut, max(late) + 1
    moves = []
    for i in range(modes):  # x moves exactly; the delayed state is linear in time over the sub-step
        chained = np.zeros((4 * n + m, 4 * n + m))
        chained[:n] = np.hstack([A[i], B[i], Ad[i], np.zeros((n, 2 * n))])
        chained[n + m : 2 * n + m, 2 * n + m : 3 * n + m] = np.eye(n) / h
        step = expm(chained * h)[:n]
        F = np.zeros((n * (depth + 1) + m, n * (depth + 1) + m))
        F[:n, :n], F[:n, -m:] = step[:, :n], step[:, n : n + m]
        z0, z1 = slice(n * late[i], n * (late[i] + 1)), slice(n * (late[i] - 1), n * late[i])
        F[:n, z0] += step[:, n + m : 2 * n + m] - step[:, 2 * n + m : 3 * n + m]
        F[:n, z1] += step[:, 2 * n + m : 3 * n + m]
        F[n : n * (depth + 1), : n * depth] = np.eye(n * depth)
        F[-m:, -m:] = np.eye(m)
        moves.append(F)
    F, chance = np.array(moves), expm(generator * h)
    samples = np.broadcast_to(np.eye(F.shape[1]), F.shape).copy()
    samples[:, -m:] = 0.0
    samples[:, -m:, :n] = K

    def move(M: Array) -> Array:
        M = samples @ M @ samples.transpose(0, 2, 1)
        for _ in range(cut):
            M = np.einsum("ij,iab->jab", chance, F @ M @ F.transpose(0, 2, 1))
        return M

    return radius(move, np.broadcast_to(np.eye(F.shape[1]), F.shape).copy())


def delayed_case(rng: np.random.Generator) -> tuple[CertificationProblem, float]:
    """The loop; the larger of its radii with drawn delays and with none."""
    n, cut = int(rng.integers(1, 3)), 4
    A, B, K = jump_matrices(rng, 2, n)
    Ad = rng.normal(scale=float(rng.choice([0.1, 0.5, 1.5])), size=A.shape)
    Q, T = rates_of(rng, 2), float(rng.choice([0.02, 0.1]))
    late = [int(v) for v in rng.integers(1, 9, 2)]
    system = JumpModel(
        A=tuple(map(rows, A)), B=tuple(map(rows, B)), Ad=tuple(map(rows, Ad)), max_delay_s=2 * T, delay_slopes=(0.3, 0.3),
    )  # fmt: skip
    loop = jump_loop(rng, system, JumpRates(rates=TransitionRates(nodes_s=(0.0,), rates=(rows(Q),))), K, T, 0)
    return loop, max(delayed_radius(A, Ad, B, K, late, Q, T, cut), sampled_radius(A + Ad, B, K, Q, T, 0))
