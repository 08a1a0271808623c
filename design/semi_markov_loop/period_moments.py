"""Second moments of a jump loop over one sample period, with jumps at any instant.

    z = (x, v_0, ..., v_-D),    dx/dt = A_l x + B_l v_-D,    v held,    l = mode

From mode i, the second moment E z z' of the paths that end in mode l without a jump is e^(-int lambda) Psi_i Z Psi_i', and of the
others the integral over the first jump, after which the constant-rate moment equation is solved exactly (matrix exponential):

    J_il = sum_j int_0^T lambda_ij e^(-lambda_i s) F_jl(T - s) (Psi_i(s) (x) Psi_i(s)) ds.

All are positive maps, so that a larger rate of jumps with a smaller rate of leaving gives a larger map, and the reverse a smaller
one: the true map lies between the two. Symmetric matrices are vectors here (``svec``), maps are matrices.

Reference: thesis (2.1), (2.16), sampled; ERRATA 11 and 12.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache

import numpy as np
from msgspec import Struct
from scipy.linalg import expm

from design.errors import FieldError
from design.processes.semi_markov import FaultDetection
from design.semi_markov_loop import FloatArray, JumpSystem, NormBounded, VertexUncertainty


class TooLarge(ValueError):
    """The loop has too many states, too long sojourns or too long periods for this test."""


STIFF = 16.0
"""Largest 2 |A| T for which the instant of the first jump is integrated."""


@cache
def isometry(n: int) -> FloatArray:
    """U with vec X = U svec X and U'U = I, shape (n^2, n (n + 1) / 2)."""
    rows, cols = np.tril_indices(n)
    out = np.zeros((n, n, rows.size))
    weight = np.where(rows == cols, 1.0, np.sqrt(0.5))
    out[rows, cols, np.arange(rows.size)] = out[cols, rows, np.arange(rows.size)] = weight
    return out.reshape(n * n, rows.size)


def svec_size(n: int) -> int:
    """Length of svec of an n x n matrix."""
    return n * (n + 1) // 2


def congruence(m: FloatArray) -> FloatArray:
    """The map X -> M X M' on svec, shape (..., p', p), for M of shape (..., n', n)."""
    after, before = isometry(m.shape[-2]), isometry(m.shape[-1])
    product = np.einsum("...ij,...kl->...ikjl", m, m).reshape(*m.shape[:-2], after.shape[0], before.shape[0])
    return np.asarray(after.T @ product @ before)


def svec(matrix: FloatArray) -> FloatArray:
    """The vector of a symmetric matrix that ``smat`` takes."""
    return np.asarray(isometry(len(matrix)).T @ matrix.ravel())


def smat(vectors: FloatArray) -> FloatArray:
    """The symmetric matrices (..., n, n) of svec ``vectors``."""
    n = round((math.sqrt(8 * vectors.shape[-1] + 1) - 1) / 2)
    return np.asarray((vectors @ isometry(n).T).reshape(*vectors.shape[:-1], n, n))


def growth_bound(before: FloatArray, after: FloatArray) -> float:
    """The least t with after <= t before, of stacks of svec; LinAlgError where not all of ``before`` are positive definite."""
    root = np.linalg.inv(np.linalg.cholesky(smat(before)))
    return float(np.linalg.eigvalsh(root @ smat(after) @ np.swapaxes(root, -1, -2))[..., -1].max())


def held_flow(a: FloatArray, b: FloatArray, size: int) -> FloatArray:
    """The generator of z = (x, v_0, ..., v_-D), shape (..., size, size), of which the oldest input acts on x."""
    n, m = b.shape[-2:]
    out = np.zeros((*a.shape[:-2], size, size))
    out[..., :n, :n], out[..., :n, size - m :] = a, b
    return out


def factors(uncertainty: NormBounded, mode: int, size: int) -> tuple[FloatArray, FloatArray]:
    """[E; 0] (size, q) and [F_A, 0, F_B] (q', size): a norm-bounded uncertainty of z."""
    n, m = uncertainty.e.shape[1], uncertainty.fb.shape[2]
    left, right = np.zeros((size, uncertainty.e.shape[2])), np.zeros((uncertainty.fa.shape[1], size))
    left[:n], right[:, :n], right[:, size - m :] = uncertainty.e[mode], uncertainty.fa[mode], uncertainty.fb[mode]
    return left, right


class Box(Struct, frozen=True, kw_only=True):
    """Bounds on the rates out of one mode over a stretch of its sojourn (1/s), each of shape (N,)."""

    low: FloatArray
    high: FloatArray

    def jump(self, upper: bool) -> FloatArray:
        """The rates of jumping that make the map larger (``upper``) or smaller."""
        return self.high if upper else self.low

    def leave(self, upper: bool) -> float:
        """The total rate of leaving that goes with them."""
        return float((self.low if upper else self.high).sum())


class PeriodMoments(Struct, frozen=True, kw_only=True, eq=False):
    """The maps of one period, from z at its start to xi = (x, v_0, ..., v_-(D-1)) at its end.

    Args:
        still: of the paths without a jump but for e^(-int lambda), shape (N, p, q).
        jumped: congruence part of the first jump at node g from i to j, ending in l: shape (N i, N j, N l, G, p, q).
        nodes_s, weights_s: instants of the first jump and their weights, shape (G,).
        period_s: T.
    """

    still: FloatArray
    jumped: FloatArray
    nodes_s: FloatArray
    weights_s: FloatArray
    period_s: float


def period_moments(
    system: JumpSystem, fresh: list[Box], period_s: float, delay: int, upper: bool, slack: float = 0.0, *, held: bool = False
) -> PeriodMoments:
    """The maps of one period.

    Args:
        system: an uncertain one has upper maps only, which bound every uncertainty that may vary freely in time.
        fresh: per mode, bounds of its rates over the first period of a sojourn.
        period_s: T (s).
        delay: D, periods between a sample and the input computed from it.
        upper: whether the maps bound from above or from below.
        slack: epsilon of ``uncertain_moments`` (1/s).
        held: whether they lead to z, of which no command is dropped: of a part of a period.
    """
    modes, n, m = system.modes, system.states, system.inputs
    size = n + m * (delay + 1)
    generators = held_flow(system.a, system.b, size)
    nodes, weights = _first_jump(2.0 * float(np.linalg.norm(system.a, 2, axis=(1, 2)).max()) * period_s, period_s)
    q, one = svec_size(size), np.eye(size)
    blocks = moment_operators(generators)
    if system.uncertainty is not None:
        if not upper:
            raise FieldError("uncertainty", "is bounded from above only")
        blocks = blocks + np.array([uncertain_moments(system.uncertainty, i, size, slack) for i in range(modes)])
    whole = _with_jumps(blocks, fresh, upper)
    flows = expm(np.multiply.outer(period_s - nodes, whole))
    flows = flows.reshape(nodes.size, modes, q, modes, q)
    drop = np.eye(q) if held else congruence(one[: size - m])
    first = expm(blocks[:, None] * nodes[:, None, None])
    jumped = np.einsum("pr,glrjs,igsq->ijlgpq", drop, flows, first, optimize=True)
    return PeriodMoments(still=drop @ expm(blocks * period_s), jumped=jumped, nodes_s=nodes, weights_s=weights, period_s=period_s)


def period_flows(system: JumpSystem, boxes: Sequence[Box], period_s: float, size: int, upper: bool) -> FloatArray:
    """The second moments of z after one period at constant rates, by the mode at its end and at its start: (N, q, N, q).

    Args:
        system: a certain one.
        boxes: per mode, bounds of its rates at any age.
        period_s: T (s).
        size: length of z.
        upper: whether the map bounds the true one from above or from below.
    """
    whole = _with_jumps(moment_operators(held_flow(system.a, system.b, size)), boxes, upper)
    q = svec_size(size)
    return np.asarray(expm(whole * period_s).reshape(system.modes, q, system.modes, q))


def moment_operators(generators: FloatArray) -> FloatArray:
    """d/dt E z z' on svec where dz/dt = G z: shape (N, q, q) for generators (N, size, size)."""
    modes, size = generators.shape[:2]
    basis, one = isometry(size), np.eye(size)
    sums = np.einsum("lij,ab->laibj", generators, one) + np.einsum("lij,ab->liajb", generators, one)
    return np.asarray(basis.T @ sums.reshape(modes, size * size, size * size) @ basis)


def _with_jumps(blocks: FloatArray, boxes: Sequence[Box], upper: bool) -> FloatArray:
    """d/dt of the moments of all modes together, shape (N q, N q), jumps at constant rates."""
    modes, q = blocks.shape[:2]
    whole = np.zeros((modes, q, modes, q))
    for i, box in enumerate(boxes):
        whole[i, :, i, :] = blocks[i] - box.leave(upper) * np.eye(q)
        for target, rate in enumerate(box.jump(upper)):
            whole[target, :, i, :] += rate * np.eye(q)
    return whole.reshape(modes * q, modes * q)


def _first_jump(stiffness: float, period_s: float) -> tuple[FloatArray, FloatArray]:
    # Gauss-Legendre with k points errs by about (stiffness / 4 k)^(2 k): far below rounding for what is allowed here. Inputs that
    # are held add powers of t up to 2, times |B|^2 at most: of the moment that they make, the share is the same in all units.
    if stiffness > STIFF:
        raise TooLarge(f"the matrices are too large for the period: 2 |A| T = {stiffness:.3g}, at most {STIFF:g} is decided")
    points, weights = np.polynomial.legendre.leggauss(6 + math.ceil(stiffness))
    return 0.5 * period_s * (points + 1.0), 0.5 * period_s * weights


def uncertain_moments(uncertainty: NormBounded | VertexUncertainty, mode: int, size: int, slack: float) -> FloatArray:
    r"""What an uncertainty may add to d/dt E z z' at most, shape (q, q) on svec.

    With y = (dA x + dB u, 0): y z' + z y' <= eps z z' + y y' / eps, and y y' <= [E; 0][E; 0]' |F_A x + F_B u|^2 (norm-bounded)
    or the sum of D_v z z' D_v' over the vertices.
    """
    total = slack * np.eye(svec_size(size))
    if isinstance(uncertainty, NormBounded):
        left, right = factors(uncertainty, mode, size)
        return np.asarray(total + np.outer(svec(left @ left.T), svec(right.T @ right)) / slack)
    changes = held_flow(uncertainty.da[:, mode], uncertainty.db[:, mode], size)
    return np.asarray(total + congruence(changes).sum(axis=0) / slack)


def pair_box(process: FaultDetection, i: int, k: int, until_s: float = math.inf) -> Box:
    """Bounds of the rates out of (eta, r) = (i, k) while r is younger than ``until_s``, by the pair eta N_r + r they lead to."""
    sides = np.zeros((2, process.failure.modes, process.detection[0].modes))
    bounds = zip(process.failure.bounds(i, 0.0, math.inf), process.detection[i].bounds(k, 0.0, until_s))
    for side, (eta, r) in zip(sides, bounds):
        side[:, k] += eta
        side[i, :] += r
    return Box(low=sides[0].ravel(), high=sides[1].ravel())


def gain_mode(measured: tuple[str, ...], process: FaultDetection, i: int, k: int) -> int:
    """Which row of the gains acts at eta = i, r = k, by what is ``measured``: (), ("r",) or ("eta", "r")."""
    return {(): 0, ("r",): k, ("eta", "r"): i * process.detection[0].modes + k}[measured]
