"""Second moments of a jump loop: over one sample period with jumps at any instant, and their growth at constant rates.

    z = (x, v_0, ..., v_-D),    dx/dt = A_l x + B_l v_-D,    v held,    l = mode

From mode i, the second moment E z z' of the paths that end in mode l without a jump is e^(-int lambda) Psi_i Z Psi_i', and of the
others the integral over the first jump, after which the constant-rate moment equation is solved exactly (matrix exponential):

    J_il = sum_j int_0^T lambda_ij e^(-lambda_i s) F_jl(T - s) (Psi_i(s) (x) Psi_i(s)) ds.

All are positive maps, so that a larger rate of jumps with a smaller rate of leaving gives a larger map, and the reverse a smaller
one: the true map lies between the two. Symmetric matrices are vectors here (``svec``), maps are matrices.

Where rates are constant the growth is exact, see `worst_growth`.

Reference: thesis (2.1), (2.16), sampled; ERRATA 11 and 12.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt
import scipy.linalg
from scipy.linalg import expm

from design.controllers.scheduled_gain import ScheduledGain
from design.errors import FieldError
from design.lmi.program import symmetric_part
from design.processes.partitions import Partition
from design.processes.semi_markov import FaultDetection
from design.semi_markov_loop.sojourn_grid import cells, pair_cells
from design.semi_markov_loop.system import JumpSystem, NormBounded, VertexUncertainty

FloatArray = npt.NDArray[np.float64]


class TooLarge(ValueError):
    """The loop has too many states, too long sojourns or too long periods for this test."""


STIFF = 16.0
"""Largest 2 |generator| T for which the instant of the first jump is integrated."""


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


def smat(vector: FloatArray) -> FloatArray:
    """The symmetric matrix of svec ``vector``."""
    n = round((np.sqrt(8 * vector.size + 1) - 1) / 2)
    return np.asarray((isometry(n) @ vector).reshape(n, n))


@dataclass(frozen=True, slots=True, kw_only=True)
class Box:
    """Bounds on the rates out of one mode over a stretch of its sojourn (1/s), each of shape (N,)."""

    low: FloatArray
    high: FloatArray

    def jump(self, upper: bool) -> FloatArray:
        """The rates of jumping that make the map larger (``upper``) or smaller."""
        return self.high if upper else self.low

    def leave(self, upper: bool) -> float:
        """The total rate of leaving that goes with them."""
        return float((self.low if upper else self.high).sum())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PeriodMoments:
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
    generators = np.zeros((modes, size, size))
    generators[:, :n, :n], generators[:, :n, size - m :] = system.a, system.b
    nodes, weights = _first_jump(2.0 * float(np.linalg.norm(generators, 2, axis=(1, 2)).max()) * period_s, period_s)
    q = svec_size(size)
    basis, one = isometry(size), np.eye(size)
    sums = np.einsum("lij,ab->laibj", generators, one) + np.einsum("lij,ab->liajb", generators, one)
    blocks = basis.T @ sums.reshape(modes, size * size, size * size) @ basis
    if system.uncertainty is not None:
        if not upper:
            raise FieldError("uncertainty", "is bounded from above only")
        blocks = blocks + np.array([uncertain_moments(system, i, size, slack) for i in range(modes)])
    whole = np.zeros((modes, q, modes, q))
    for j, box in enumerate(fresh):
        whole[j, :, j, :] = blocks[j] - box.leave(upper) * np.eye(q)
        for target, rate in enumerate(box.jump(upper)):
            whole[target, :, j, :] += rate * np.eye(q)
    flows = expm(np.multiply.outer(period_s - nodes, whole.reshape(modes * q, modes * q)))
    flows = flows.reshape(nodes.size, modes, q, modes, q)
    drop = np.eye(q) if held else congruence(one[: size - m])
    first = expm(blocks[:, None] * nodes[:, None, None])
    jumped = np.einsum("pr,glrjs,igsq->ijlgpq", drop, flows, first, optimize=True)
    return PeriodMoments(still=drop @ expm(blocks * period_s), jumped=jumped, nodes_s=nodes, weights_s=weights, period_s=period_s)


def _first_jump(stiffness: float, period_s: float) -> tuple[FloatArray, FloatArray]:
    # Gauss-Legendre with k points errs by about (stiffness / 4 k)^(2 k): far below rounding for what is allowed here.
    if stiffness > STIFF:
        raise TooLarge(f"the matrices are too large for the period: 2 |A, B| T = {stiffness:.3g}, at most {STIFF:g} is decided")
    points, weights = np.polynomial.legendre.leggauss(6 + math.ceil(stiffness))
    return 0.5 * period_s * (points + 1.0), 0.5 * period_s * weights


def uncertain_moments(system: JumpSystem, mode: int, size: int, slack: float) -> FloatArray:
    r"""What an uncertainty may add to d/dt E z z' at most, shape (q, q) on svec.

    With y = (dA x + dB u, 0): y z' + z y' <= eps z z' + y y' / eps, and y y' <= [E; 0][E; 0]' |F_A x + F_B u|^2 (norm-bounded)
    or the sum of D_v z z' D_v' over the vertices.
    """
    uncertainty, n, m = system.uncertainty, system.states, system.inputs
    total = slack * np.eye(svec_size(size))
    if isinstance(uncertainty, NormBounded):
        left, right = np.zeros((size, uncertainty.e.shape[2])), np.zeros((uncertainty.fa.shape[1], size))
        left[:n], right[:, :n], right[:, size - m :] = uncertainty.e[mode], uncertainty.fa[mode], uncertainty.fb[mode]
        u = isometry(size)
        return np.asarray(total + np.outer(u.T @ (left @ left.T).ravel(), u.T @ (right.T @ right).ravel()) / slack)
    if isinstance(uncertainty, VertexUncertainty):
        change = np.zeros((uncertainty.da.shape[0], size, size))
        change[:, :n, :n], change[:, :n, size - m :] = uncertainty.da[:, mode], uncertainty.db[:, mode]
        return np.asarray(total + congruence(change).sum(axis=0) / slack)
    return np.zeros_like(total)


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


def worst_growth(
    system: JumpSystem, gain: ScheduledGain, process: FaultDetection
) -> tuple[float, dict[str, tuple[float, ...]]] | None:
    """The fastest growth of E|x|^2 (1/s) over all vertices of the rate bounds held constant, with these rates.

        d/dt vec M_i = (A_i (+) A_i) vec M_i + sum_j lambda_ji vec M_j - lambda_i vec M_i,     M_i = E x x' 1{mode = i}

    If the spectral abscissa of this generator is positive at constant rates that the bounds allow, no certificate over these
    bounds can exist; if it is negative at all corners, nothing is proved about rates that vary.

    Exact at every vertex (spectral abscissa of the second-moment generator), for gains without sections. None if there are
    more than 4096 vertices.
    """
    n_eta, n_r = system.modes, process.detection[0].modes
    one = ((0.0,),)
    eta = {cell.mode: cell.rates for cell in cells(process.failure, one * n_eta)}
    r = {(i, c.mode): c.rates for i in range(n_eta) for c in cells(process.detection[i], one * n_r)}
    keys: list[tuple[int, ...]] = [*((i,) for i in eta), *r]
    options = [eta[key[0]] if len(key) == 1 else r[key[0], key[1]] for key in keys]
    if np.prod([len(option) for option in options]) > 4096:
        return None
    acting = [[gain.gain[gain_mode(gain.measured, process, i, k), 0] @ system.shown(i) for k in range(n_r)] for i in range(n_eta)]
    loops = np.array([[system.a[i] + system.b[i] @ each for each in row] for i, row in enumerate(acting)])
    worst: tuple[float, dict[str, tuple[float, ...]]] = (-np.inf, {})
    for choice in itertools.product(*options):
        rates = dict(zip(keys, choice))
        generator = np.zeros((n_eta, n_r, n_eta, n_r))
        for i, k in itertools.product(range(n_eta), range(n_r)):
            generator[i, k, :, k] += rates[(i,)]
            generator[i, k, i, :] += rates[i, k]
        growth = mean_square_abscissa(loops.reshape(-1, *loops.shape[2:]), generator.reshape(n_eta * n_r, -1))
        if growth > worst[0]:
            worst = growth, {f"eta={key[0]}" + (f", r={key[1]}" if len(key) > 1 else ""): rates[key] for key in keys}
    return worst


def mean_square_abscissa(loops: FloatArray, rates: FloatArray) -> float:
    """Growth rate of E|x|^2 of a Markov jump system dx = A_i x (1/s): the abscissa of blkdiag(A_i (+) A_i) + (Lambda' (x) I).

    Args:
        loops: shape (N, n, n).
        rates: jump rates, shape (N, N); the diagonal is ignored.
    """
    modes, n = loops.shape[:2]
    eye = np.eye(n)
    rates = rates * (1.0 - np.eye(modes))
    out = np.kron(rates.T - np.diag(rates.sum(axis=1)), np.eye(n * n))
    for i in range(modes):
        block = slice(i * n * n, (i + 1) * n * n)
        out[block, block] += np.kron(loops[i], eye) + np.kron(eye, loops[i])
    return float(np.linalg.eigvals(out).real.max())


def proved_decay(
    system: JumpSystem,
    process: FaultDetection,
    gain: ScheduledGain,
    eta_nodes: Partition,
    r_nodes: Partition,
    matrices: Mapping[str, FloatArray],
) -> float:
    """The largest alpha (1/s) such that V falls like e^(-alpha t) with the P of a certificate: E|x|^2 does at least that.

    d/dt V <= -alpha V on every cell at every rate within its bounds, and V falls where a clock enters a new section.
    """
    rates = []
    for cell in pair_cells(process, eta_nodes, r_nodes):
        mode = gain_mode(gain.measured, process, cell.i, cell.k)
        loop = system.a[cell.i] + system.b[cell.i] @ gain.at(mode, r_nodes[cell.k][cell.b]) @ system.shown(cell.i)
        own = matrices[f"P[{cell.i},{cell.k},{cell.a},{cell.b}]"]
        after = 0 if process.failure_restarts_detection_clock else cell.b
        for failure, detection in cell.vertices:
            change = symmetric_part(own @ loop)
            for j, rate in enumerate(failure):
                if rate > 0:
                    change = change + rate * (matrices[f"P[{j},{cell.k},0,{after}]"] - own)
            for l, rate in enumerate(detection):
                if rate > 0:
                    change = change + rate * (matrices[f"P[{cell.i},{l},{cell.a},0]"] - own)
            rates.append(float(scipy.linalg.eigh(-change, own, eigvals_only=True)[0]))
    return min(rates)
