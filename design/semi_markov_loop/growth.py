"""How fast the second moments of a jump loop with constant rates grow: the exact verdict at every corner of the rate bounds.

    d/dt vec M_i = (A_i (+) A_i) vec M_i + sum_j lambda_ji vec M_j - lambda_i vec M_i,     M_i = E x x' 1{mode = i}

If the spectral abscissa of this generator is positive at constant rates that the bounds allow, no certificate over these bounds
can exist; if it is negative at all corners, nothing is proved about rates that vary.

Reference: ERRATA 11 and 12.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
import scipy.linalg

from design.controllers.scheduled_gain import ScheduledGain
from design.lmi.program import symmetric_part
from design.processes.partitions import Partition
from design.processes.semi_markov import FaultDetection
from design.semi_markov_loop.pair_cells import pair_cells
from design.semi_markov_loop.sojourn_grid import cells
from design.semi_markov_loop.system import JumpSystem

FloatArray = npt.NDArray[np.float64]


def gain_mode(gain: ScheduledGain, process: FaultDetection, i: int, k: int) -> int:
    """Which row of the gains acts at eta = i, r = k; depends on what is ``measured``: (), ("r",) or ("eta", "r")."""
    return {(): 0, ("r",): k, ("eta", "r"): i * process.detection[0].modes + k}[gain.measured]


def worst_growth(
    system: JumpSystem, gain: ScheduledGain, process: FaultDetection
) -> tuple[float, dict[str, tuple[float, ...]]] | None:
    """The fastest growth of E|x|^2 (1/s) over all vertices of the rate bounds held constant, with these rates.

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
    loops = np.array(
        [
            [system.a[i] + system.b[i] @ gain.gain[gain_mode(gain, process, i, k), 0] for k in range(n_r)]
            for i in range(n_eta)
        ]
    )
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
        mode = gain_mode(gain, process, cell.i, cell.k)
        loop = system.a[cell.i] + system.b[cell.i] @ gain.at(mode, r_nodes[cell.k][cell.b])
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
