"""The fault-tolerant conditions (4.26) and (4.27) as they are printed. NOT SOUND with sections; kept to be compared with.

They give K_ik, which needs the fault i; upper off-diagonal rates stand with lower diagonal ones (sound, but loose);
(4.27) has one section index m for two clocks, tests only the pairs (m, m) and links no sections. ``vertices=True`` takes
exact rate vertices instead of the mixed bounds and keeps everything else.

References: thesis (4.18)-(4.20), (4.26), (4.27); ERRATA 11, 12 and 13.
"""

from __future__ import annotations

import itertools
import math
from functools import partial

import numpy as np

from design.errors import Infeasible
from design.lmi.decision import at_gamma, smallest_gamma
from design.lmi.program import Array, LmiProgram, add_schur_rows, gain_limit, symmetric_blocks, symmetric_part
from design.processes.partitions import Partition
from design.processes.semi_markov import FaultDetection
from design.semi_markov_loop.certificate import JumpCertificate, Verdict
from design.semi_markov_loop.fault_tolerant_analysis import check_loop
from design.semi_markov_loop.system import JumpSystem

Corner = tuple[float, list[tuple[float, tuple[int, int]]]]


def _corners(
    process: FaultDetection, i: int, k: int, edges: tuple[list[float], list[float]], m: int, vertices: bool
) -> list[Corner]:
    """(total rate on the diagonal, [(rate, landing pair)])."""
    eta_low, eta_high = process.failure.bounds(i, edges[0][m], edges[0][m + 1])
    r_low, r_high = process.detection[i].bounds(k, edges[1][m], edges[1][m + 1])
    places = [(j, k) for j in range(eta_high.size) if eta_high[j] > 0] + [(i, l) for l in range(r_high.size) if r_high[l] > 0]
    low = [float(v) for v, h in zip([*eta_low, *r_low], [*eta_high, *r_high]) if h > 0]
    high = [float(h) for h in [*eta_high, *r_high] if h > 0]
    if not vertices:
        return [(sum(low), list(zip(high, places)))]
    return [(sum(rates), list(zip(rates, places))) for rates in itertools.product(*({a, b} for a, b in zip(low, high)))]


def _program(
    system: JumpSystem,
    process: FaultDetection,
    edges: tuple[list[list[float]], list[list[float]]],
    m: int,
    gains: Array | None,
    gain_bound: float,
    vertices: bool,
    scale: float,
) -> LmiProgram:
    program = LmiProgram()
    n, inputs, detections = system.states, system.inputs, process.detection[0].modes
    program.matrix("g2", 1, 1)
    if gains is None:
        program.matrix("s", 1, 1)
    for i, k in itertools.product(range(system.modes), range(detections)):
        x, r = f"X[{i},{k}]", f"R[{i},{k}]"
        program.symmetric(x, n)
        program.require(f"{x} > 0", lambda v: -v, x)
        if gains is None:
            program.matrix(r, inputs, n)
            program.require(f"{x} >= s I", lambda v, s: s * np.eye(n) - v, x, "s", strict=False)
            program.require("gain bound", partial(gain_limit, bound=gain_bound), x, r, "s", strict=False)
    for i, k in itertools.product(range(system.modes), range(detections)):
        for total, jumps in _corners(process, i, k, (edges[0][i], edges[1][k]), m, vertices):
            known = None if gains is None else gains[i, k]
            function = partial(_block, system=system, mode=i, gain=known, total=total, rates=[v for v, _ in jumps], scale=scale)
            own = (f"X[{i},{k}]", *(() if gains is not None else (f"R[{i},{k}]",)))
            program.require(f"modes {i}, {k}", function, *own, "g2", *(f"X[{j},{l}]" for _, (j, l) in jumps))
    return program


def _block(
    x: Array,
    *rest: Array,
    system: JumpSystem,
    mode: int,
    gain: Array | None,
    total: float,
    rates: list[float],
    scale: float,
) -> Array:
    r, (g2, *landing) = (gain @ x, rest) if gain is not None else (rest[0], rest[1:])
    a, b, c, e = (matrix[mode] for matrix in (system.a, system.b, system.c, system.e) if matrix is not None)
    rows: list[list[Array | None]] = [
        [symmetric_part(a @ x + b @ r) - total * x],
        [e.T, -g2 * np.eye(e.shape[1])],
        [scale * (c @ x), None, -np.eye(c.shape[0])],
    ]
    add_schur_rows(rows, (math.sqrt(rate) * x for rate in rates), landing)
    return symmetric_blocks(rows)


def printed_section(
    system: JumpSystem,
    process: FaultDetection,
    eta_sections: Partition,
    r_sections: Partition,
    m: int,
    gains: Array | None,
    *,
    gain_bound: float = math.inf,
    vertices: bool = False,
    gamma: float | None = None,
) -> JumpCertificate:
    """Condition (4.27) of section m (from 0; (4.26) with one section): smallest gamma, or the verdict at one.

    Args:
        gains: K_ik of this section, shape (N_eta, N_r, m, n), or None to leave them free within ``gain_bound``.

    Returns:
        A certificate with ``sound = False``, whatever it says.
    """
    check_loop(system, process)
    edges = [[*row, math.inf] for row in eta_sections], [[*row, math.inf] for row in r_sections]
    build = partial(_program, system, process, edges, m, gains, min(gain_bound, 1e6), vertices)
    what = f"printed (4.{27 if len(eta_sections[0]) > 1 else 26}), section {m + 1}"
    try:
        result = smallest_gamma(build, what) if gamma is None else at_gamma(build, gamma, what)
    except Infeasible as error:
        verdict: Verdict = "refused" if error.proved else "undecided"
        return JumpCertificate(method="printed", sound=False, verdict=verdict, reason=str(error))
    return JumpCertificate(
        method="printed", sound=False, verdict="certified", reason=result.found.explain(), gamma=result.gamma,
        margin=result.found.margin, matrices=result.found.matrices, scale=result.scale, solver=result.found.solver,
        assumptions=("the controller measures the fault (false)", "both clocks share one section, sections need no link (false)"),
    )  # fmt: skip
