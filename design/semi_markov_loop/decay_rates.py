"""How fast loops decay, from their certificates, and how fast they grow where rates are constant.

The decay rate and coefficient of a delayed loop, E|x(t)|^2 <= sigma e^(-rate t) sup |phi|^2: with V of `delayed_hinf` and no
disturbance, AV <= -mu |x|^2 and

    p |x|^2 <= V <= a |x|^2 + b int_{t-tau}^t |x|^2,    a = max |P|, b = (1 + eta tau) |Q|, p = min 1 / |P^-1|

The integral of e^(rate t) int_{t-tau}^t |x|^2 is at most tau e^(rate tau) times that of e^(rate t) |x|^2 from -tau on, so that
the largest rate with rate (a + b tau e^(rate tau)) <= mu gives sigma = (a + b tau + rate b tau^2 e^(rate tau)) / p.

References: thesis Definition 3.1, (3.5), (3.14); ERRATA 11 and 12.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.linalg import block_diag, eigh

from design.controllers.scheduled_gain import ScheduledGain
from design.errors import FieldError
from design.lmi.program import symmetric_part
from design.processes.partitions import Partition
from design.processes.semi_markov import FaultDetection, SemiMarkov
from design.semi_markov_loop.certificate import JumpCertificate
from design.semi_markov_loop.delayed_hinf import fastest_exit
from design.semi_markov_loop.period_moments import gain_mode, moment_operators
from design.semi_markov_loop.sojourn_grid import cells, pair_cells, pair_corners
from design.semi_markov_loop.system import DelayedJumpSystem, JumpSystem

FloatArray = npt.NDArray[np.float64]


class Decay(NamedTuple):
    """Decay rate (1/s) and decay coefficient of (3.5)."""

    rate: float
    coefficient: float


def decay_of(system: DelayedJumpSystem, process: SemiMarkov, certificate: JumpCertificate) -> Decay:
    """Return rate and coefficient that a certificate of `analyse_delayed` (``pwc``) proves of the loop without disturbance.

    Raises:
        ValueError: the certificate is not certified, or its P is not constant per section.
    """
    if not certificate.certified or certificate.method != "pwc" or certificate.gain is None:
        raise FieldError("certificate", f"{certificate.verdict} by {certificate.method!r}, expected certified by 'pwc'")
    gain, found = certificate.gain, certificate.matrices
    sections = tuple(tuple(row.tolist()) for row in gain.starts_s)
    eta, tau, q = fastest_exit(process, sections), system.delay_max_s, found["Q"]
    least, most, smallest = math.inf, 0.0, math.inf
    for cell in cells(process, sections):
        i, p = cell.mode, found[f"P[{cell.mode},{cell.index}]"]
        a = system.a[i] + system.b[i] @ gain.at(i, cell.start)
        late = p @ system.ad[i]
        delayed = late @ np.linalg.solve((1.0 - system.delay_slopes[i]) * q, late.T)
        for rates in cell.rates:
            jumps = sum(rate * (found[f"P[{j},0]"] - p) for j, rate in enumerate(rates) if rate > 0)
            falls = -(p @ a + a.T @ p + jumps + (1.0 + eta * tau) * q + delayed)
            least = min(least, float(np.linalg.eigvalsh(falls)[0]))
        eigenvalues = np.linalg.eigvalsh(p)
        smallest, most = min(smallest, float(eigenvalues[0])), max(most, float(eigenvalues[-1]))
    held = (1.0 + eta * tau) * float(np.linalg.eigvalsh(q)[-1])

    def demand(rate: float) -> float:
        return rate * (most + held * tau * math.exp(rate * tau))

    low, high = 0.0, least / most
    for _ in range(200):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if demand(middle) <= least else (low, middle)
    return Decay(low, (most + held * tau + low * held * tau * tau * math.exp(low * tau)) / smallest)


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
    loops = np.array([system.a[i] + system.b[i] @ each for i, row in enumerate(acting) for each in row])
    alone = block_diag(*moment_operators(loops))
    worst: tuple[float, dict[str, tuple[float, ...]]] = (-np.inf, {})
    for choice in itertools.product(*options):
        rates = dict(zip(keys, choice))
        generator = np.zeros((n_eta, n_r, n_eta, n_r))
        for i, k in itertools.product(range(n_eta), range(n_r)):
            generator[i, k, :, k] += rates[(i,)]
            generator[i, k, i, :] += rates[i, k]
        growth = _abscissa(alone, generator.reshape(n_eta * n_r, -1))
        if growth > worst[0]:
            worst = growth, {f"eta={key[0]}" + (f", r={key[1]}" if len(key) > 1 else ""): rates[key] for key in keys}
    return worst


def mean_square_abscissa(loops: FloatArray, rates: FloatArray) -> float:
    """Growth rate of E|x|^2 of a Markov jump system dx = A_i x (1/s): the abscissa of blkdiag(A_i (+) A_i) + (Lambda' (x) I).

    Args:
        loops: shape (N, n, n).
        rates: jump rates, shape (N, N); the diagonal is ignored.
    """
    return _abscissa(block_diag(*moment_operators(loops)), rates)


def _abscissa(alone: FloatArray, rates: FloatArray) -> float:
    modes, size = len(rates), len(alone) // len(rates)
    rates = rates * (1.0 - np.eye(modes))
    out = alone.copy()
    np.einsum("iaja->aij", out.reshape(modes, size, modes, size))[...] += rates.T - np.diag(rates.sum(axis=1))
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
    for eta, r in pair_cells(process, eta_nodes, r_nodes):
        i, k = eta.mode, r.mode
        loop = system.a[i] + system.b[i] @ gain.at(gain_mode(gain.measured, process, i, k), r.start) @ system.shown(i)
        own = matrices[f"P[{i},{k},{eta.index},{r.index}]"]
        for jumps in pair_corners(process, eta, r):
            change = symmetric_part(own @ loop)
            for rate, place in jumps:
                change = change + rate * (matrices["P[{},{},{},{}]".format(*place)] - own)
            rates.append(float(eigh(-change, own, eigvals_only=True)[0]))
    return min(rates)
