"""The delayed H-infinity conditions of Chapter 3 as they are printed. NOT SOUND; kept to be compared with.

- ``literal``: (3.42) as it stands: off-diagonal rates in {low, high} against -low P_j on the diagonal, the same for 1 + eta tau.
- ``consistent``: (3.41) with one rate in both places, the only reading at which the published gains fit gamma = 0.93.

Both keep C'C and B'P, which belong to P coordinates, in an inequality in X = P^-1 coordinates (the condition is then the bounded
real lemma of (A', B, C)), let jumps land in the same section, link no sections, and give each section its own Q and eta.

References: thesis (3.27), (3.40)-(3.42); ERRATA 9 and 10.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from functools import partial
from typing import Literal

import numpy as np

from design.controllers.scheduled_gain import ScheduledGain
from design.errors import Infeasible
from design.lmi.decision import at_gamma, smallest_gamma
from design.lmi.program import Array, LmiProgram, add_schur_rows, gain_limit, symmetric_blocks, symmetric_part
from design.processes.partitions import Partition
from design.processes.semi_markov import SemiMarkov
from design.semi_markov_loop.certificate import JumpCertificate, Verdict
from design.semi_markov_loop.system import DelayedJumpSystem

Reading = Literal["literal", "consistent"]
Corner = tuple[float, list[tuple[float, float]], tuple[float, float]]
"""(total rate on the diagonal, [(rate in the row, rate on the diagonal)] per target, the same for 1 + eta tau)."""


def _corners(system: DelayedJumpSystem, low: Array, high: Array, mode: int, reading: Reading) -> Iterator[Corner]:
    tau = system.delay_max_s
    etas = float(low.sum(axis=1).max()), float(high.sum(axis=1).max())
    targets = [j for j in range(system.modes) if high[mode, j] > 0]
    for rates in itertools.product(*(sorted({float(low[mode, j]), float(high[mode, j])}) for j in targets)):
        for eta in sorted(set(etas)):
            held = 1.0 + eta * tau
            if reading == "literal":
                lower = 1.0 + etas[0] * tau
                pairs = [(rate, float(low[mode, j])) for rate, j in zip(rates, targets)]
                yield float(low[mode].sum()), pairs, (held, lower)
            else:
                yield sum(rates), [(rate, rate) for rate in rates], (held, held)


def _program(
    system: DelayedJumpSystem,
    bounds: tuple[Array, Array],
    gains: Array | None,
    gain_bound: float,
    reading: Reading,
    scale: float,
) -> LmiProgram:
    program = LmiProgram()
    n, m = system.states, system.inputs
    program.symmetric("Q", n)
    program.matrix("g2", 1, 1)
    program.require("Q > 0", lambda q: -q, "Q")
    if gains is None:
        program.matrix("s", 1, 1)
    for i in range(system.modes):
        program.symmetric(f"X[{i}]", n)
        program.require(f"X[{i}] > 0", lambda x: -x, f"X[{i}]")
        if gains is None:
            program.matrix(f"U[{i}]", m, n)
            program.require(f"X[{i}] >= s I", lambda x, s: s * np.eye(n) - x, f"X[{i}]", "s", strict=False)
            program.require("gain bound", partial(gain_limit, bound=gain_bound), f"X[{i}]", f"U[{i}]", "s", strict=False)
    for i in range(system.modes):
        for total, pairs, held in _corners(system, *bounds, i, reading):
            targets = [j for j in range(system.modes) if bounds[1][i, j] > 0]
            on = (f"X[{i}]", *(() if gains is not None else (f"U[{i}]",)), "Q", "g2", *(f"X[{j}]" for j in targets))
            known = None if gains is None else gains[i]
            function = partial(
                _block, system=system, mode=i, gain=known, total=total, pairs=pairs, held=held, scale=scale
            )
            program.require(f"({reading}) mode {i}", function, *on)
    return program


def _block(
    x: Array,
    *rest: Array,
    system: DelayedJumpSystem,
    mode: int,
    gain: Array | None,
    total: float,
    pairs: list[tuple[float, float]],
    held: tuple[float, float],
    scale: float,
) -> Array:
    u, (q, g2, *landing) = (gain @ x, rest) if gain is not None else (rest[0], rest[1:])
    a, b, ad, e, c = (m[mode] for m in (system.a, system.b, system.ad, system.e, system.c))
    # A row [v X, -w Y] is scaled to [v/sqrt(w) X, -Y]; w = 0 with v > 0 is the singular block of (3.40).
    rows: list[list[Array | None]] = [
        [symmetric_part(a @ x + b @ u) - total * x + scale * scale * (c.T @ c)],
        [q @ ad.T, -(1.0 - system.delay_slopes[mode]) * q],
        [held[0] / math.sqrt(held[1]) * x, None, -q],
        [e.T @ x, None, None, -g2 * np.eye(e.shape[1])],
    ]
    jumps = [(rate / math.sqrt(max(divisor, 1e-12)), after) for (rate, divisor), after in zip(pairs, landing) if rate > 0]
    add_schur_rows(rows, (weight * x for weight, _ in jumps), (after for _, after in jumps))
    return symmetric_blocks(rows)


def printed_section(
    system: DelayedJumpSystem,
    process: SemiMarkov,
    sections: Partition,
    m: int,
    gain: ScheduledGain | None,
    *,
    reading: Reading = "literal",
    gain_bound: float = math.inf,
    gamma: float | None = None,
) -> JumpCertificate:
    """The printed condition of section m (from 0): smallest gamma, or the verdict at one; gains free if ``gain`` is None.

    Never sound. Raises ValueError if the data do not fit.
    """
    edges = [[*row, math.inf] for row in sections]
    pairs = [process.bounds(i, edges[i][m], edges[i][m + 1]) for i in range(system.modes)]
    bounds = np.array([low for low, _ in pairs]), np.array([high for _, high in pairs])
    gains = None if gain is None else np.array([gain.at(i, edges[i][m]) for i in range(system.modes)])
    build = partial(_program, system, bounds, gains, min(gain_bound, 1e6), reading)
    what = f"printed Corollary 3.2 ({reading}), section {m + 1}"
    try:
        result = smallest_gamma(build, what) if gamma is None else at_gamma(build, gamma, what)
    except Infeasible as error:
        verdict: Verdict = "refused" if error.proved else "undecided"
        return JumpCertificate(method="printed", sound=False, verdict=verdict, reason=str(error), gain=gain)
    return JumpCertificate(
        method="printed", sound=False, verdict="certified", reason=result.found.explain(), gamma=result.gamma, gain=gain,
        margin=result.found.margin, matrices=result.found.matrices, scale=result.scale, solver=result.found.solver,
        assumptions=("C'C and B'P may stand in X coordinates (false)", "sections need no link (false)"),
    )  # fmt: skip


def inequality_at(
    system: DelayedJumpSystem, certificate: JumpCertificate, mode: int, rates: Sequence[float], eta: float
) -> Array:
    """(3.41) of a mode at one value of its rates, with the matrices of a certificate whose gains were free.

    Args:
        rates: to every mode, (N,); its own entry is not read (1/s).
        eta: bound of the total rates (1/s).

    Returns:
        symmetric; negative definite where (3.41) holds.
    """
    found = certificate.matrices
    targets = [j for j, rate in enumerate(rates) if j != mode and rate > 0]
    held = 1.0 + eta * system.delay_max_s
    g2 = np.array([[(certificate.scale * (certificate.gamma or math.inf)) ** 2]])
    return _block(
        found[f"X[{mode}]"], found[f"U[{mode}]"], found["Q"], g2, *(found[f"X[{j}]"] for j in targets), system=system,
        mode=mode, gain=None, total=sum(rates[j] for j in targets), pairs=[(rates[j], rates[j]) for j in targets],
        held=(held, held), scale=certificate.scale,
    )  # fmt: skip
