"""H-infinity state feedback for semi-Markov jump systems with a time-varying state delay (Chapter 3), corrected.

    V = x'P_i(h)x + int_{t-tau}^t x'Qx + eta int_{-tau_max}^0 int_{t+s}^t x'Qx,    eta = max_{i,h} |lambda_ii(h)|, one Q

    [ A_i'P_i + P_i A_i + dP_i/dh + sum_j lambda_ij (P_j(0) - P_i) + (1 + eta tau_max) Q + C'C      *             *    ]
    [ Ad' P_i                                                                                  -(1 - slope_i) Q   *    ] < 0
    [ E' P_i                                                                                        0         -gamma^2 ]

at every rate vertex of every cell, A_i = A_i + B_i K(i, h). ``analyse_delayed`` checks given gains in this form (``pwc``: P
constant per section with P_{i,m+1} <= P_{i,m}; ``pwl``: linear in h). ``delayed_hinf`` finds gains in X = P^-1, U = K X.
Without a gain bound the infimum of gamma is 0 (the disturbance is matched and z holds no u), so a bound is required.

The decay rate and coefficient, E|x(t)|^2 <= sigma e^(-rate t) sup |phi|^2 (``decay_of``): with V and no disturbance,
AV <= -mu |x|^2 and

    p |x|^2 <= V <= a |x|^2 + b int_{t-tau}^t |x|^2,    a = max |P|, b = (1 + eta tau) |Q|, p = min 1 / |P^-1|

The integral of e^(rate t) int_{t-tau}^t |x|^2 is at most tau e^(rate tau) times that of e^(rate t) |x|^2 from -tau on, so that
the largest rate with rate (a + b tau e^(rate tau)) <= mu gives sigma = (a + b tau + rate b tau^2 e^(rate tau)) / p.

The printed forms live in ``design.as_printed.chapters_2_to_4``. References: thesis Definition 3.1, (3.5), (3.7), (3.14), (3.27),
(3.42); ERRATA 9 to 12.
"""

from __future__ import annotations

import math
from functools import partial
from typing import NamedTuple

import numpy as np

from design.controllers.scheduled_gain import ScheduledGain
from design.errors import FieldError, Infeasible
from design.lmi import Lift, as_float, attenuation
from design.lmi.program import Array, Inequality, LmiProgram, check_gain_bound, symmetric_blocks, symmetric_part, transpose
from design.processes.partitions import Partition
from design.processes.semi_markov import SemiMarkov
from design.semi_markov_loop import DelayedJumpSystem
from design.semi_markov_loop.certificate import JumpCertificate, Method, attenuation_certificate
from design.semi_markov_loop.sojourn_grid import Cell, along_cells, bounded_gains, cells, require_inverse

ASSUMPTIONS = (
    "rates anywhere in their bounds on every section",
    "delay and its growth within their bounds",
    "x(t) = 0 for t <= 0",
)


def fastest_exit(process: SemiMarkov, nodes: Partition) -> float:
    """eta = the largest total rate out of any mode at any sojourn time (1/s)."""
    return max(sum(rates) for cell in cells(process, nodes) for rates in cell.rates)


def delayed_inequalities(
    system: DelayedJumpSystem,
    process: SemiMarkov,
    gain: ScheduledGain,
    nodes: Partition,
    method: Method,
    scale: float,
    gamma: float | None,
    lift: Lift = as_float,
) -> list[Inequality]:
    """Every inequality on P[i,r], Q and, where gamma is not known, g2 = (scale gamma)^2; z scaled by ``scale``."""
    change = partial(_bounded_real, system=system, eta=fastest_exit(process, nodes), scale=scale, lift=lift)
    out = along_cells([change], process, gain, nodes, method, shared=("Q", "g2"), lift=lift)
    return out if gamma is None else [item.fixing({"g2": lift([[(scale * gamma) ** 2]])}) for item in out]


def _bounded_real(
    cell: Cell,
    k: Array,
    flow: Array,
    p: Array,
    q: Array,
    g2: Array,
    *,
    system: DelayedJumpSystem,
    eta: float,
    scale: float,
    lift: Lift,
) -> Array:
    i = cell.mode
    a, b, ad, e, c = (lift(m[i]) for m in (system.a, system.b, system.ad, system.e, system.c))
    held = 1 + lift(eta) * lift(system.delay_max_s)
    value = symmetric_part(p @ (a + b @ k)) + flow + held * q + lift(scale) * lift(scale) * (c.T @ c)
    delayed = -(1 - lift(system.delay_slopes[i])) * q
    return symmetric_blocks([[value], [transpose(p @ ad), delayed], [transpose(p @ e), None, -g2 * lift(np.eye(e.shape[1]))]])


def analyse_delayed(
    system: DelayedJumpSystem,
    gain: ScheduledGain,
    process: SemiMarkov,
    *,
    method: Method = "pwc",
    nodes: Partition | None = None,
    gamma: float | None = None,
) -> JumpCertificate:
    """The smallest gamma that is certified for given gains, or the verdict at a given gamma.

    Args:
        nodes: sections (``pwc``) or nodes (``pwl``) of P per mode; by default the section starts of the gains.

    Returns:
        The certificate; ``refused`` or ``undecided`` with the reason where no matrices could be verified.

    Raises:
        ValueError: shapes that do not fit, rates without finite bounds.
    """
    system.check(process, gain)
    starts = nodes if nodes is not None else tuple(tuple(row.tolist()) for row in gain.starts_s)
    if method not in ("pwl", "pwc"):
        raise FieldError("method", f"{method!r} is not pwl or pwc")

    def build(scale: float) -> LmiProgram:
        program = LmiProgram()
        for i, row in enumerate(starts):
            for r in range(len(row)):
                program.symmetric(f"P[{i},{r}]", system.states)
        program.symmetric("Q", system.states)
        program.matrix("g2", 1, 1)
        program.inequalities = delayed_inequalities(system, process, gain, starts, method, scale, None)
        return program

    return attenuation_certificate(
        partial(attenuation, build, f"H-infinity norm of the delayed loop ({method})", gamma), method=method, gain=gain,
        assumptions=ASSUMPTIONS, rebuild=partial(delayed_inequalities, system, process, gain, starts, method),
    )  # fmt: skip


def synthesis_program(
    system: DelayedJumpSystem, process: SemiMarkov, sections: Partition, gain_bound: float, scale: float
) -> LmiProgram:
    """The corrected (3.42) on X[i,m], U[i,m], Q, s and g2; X >= s I and [[k^2 s I, U], [U', X]] >= 0 bound the gains."""
    program = LmiProgram()
    program.symmetric("Q", system.states)
    program.matrix("g2", 1, 1)
    program.matrix("s", 1, 1)
    for i, row in enumerate(sections):
        for r in range(len(row)):
            program.symmetric(f"X[{i},{r}]", system.states)
            program.bounded_gain(f"X[{i},{r}]", f"U[{i},{r}]", system.inputs, gain_bound)
    block = partial(_synthesis_block, system=system, eta=fastest_exit(process, sections), scale=scale)
    require_inverse(program, [block], process, sections, "pwc", at_nodes=("U",), shared=("Q", "g2"))
    return program


def _synthesis_block(
    cell: Cell, x: Array, u: Array, q: Array, g2: Array, *, system: DelayedJumpSystem, eta: float, scale: float
) -> list[list[Array | None]]:
    a, b, ad, e, c = (m[cell.mode] for m in (system.a, system.b, system.ad, system.e, system.c))
    return [
        [symmetric_part(a @ x + b @ u)],
        [q @ ad.T, -(1.0 - system.delay_slopes[cell.mode]) * q],
        [math.sqrt(1.0 + eta * system.delay_max_s) * x, None, -q],
        [e.T, None, None, -g2 * np.eye(e.shape[1])],
        [scale * (c @ x), None, None, None, -np.eye(c.shape[0])],
    ]


def delayed_hinf(
    system: DelayedJumpSystem,
    process: SemiMarkov,
    *,
    gain_bound: float,
    sections: Partition | None = None,
    gamma: float | None = None,
) -> JumpCertificate:
    """State feedback K(i, m) with the smallest certified gamma under a gain bound, or at a given gamma.

    Args:
        gain_bound: largest spectral norm of any gain; required, the infimum of gamma is 0 without one.
        sections: section starts per mode; by default one section.

    Returns:
        The certificate of the gains (``.gain``), found again from the gains alone by ``analyse_delayed``.

    Raises:
        ValueError: data that do not fit.
        Infeasible: no such gains exist (proved) or none could be verified.
    """
    check_gain_bound(gain_bound)
    system.check(process)
    starts = sections if sections is not None else ((0.0,),) * system.modes
    build = partial(synthesis_program, system, process, starts, gain_bound)
    what = f"delayed H-infinity feedback with gain norm <= {gain_bound:g}"
    gain = bounded_gains(attenuation(build, what, gamma).found.matrices, "U", starts, gain_bound)
    certificate = analyse_delayed(system, gain, process, nodes=starts)
    if not certificate.certified or (gamma is not None and (certificate.gamma or math.inf) > gamma):
        raise Infeasible(f"{what}: gains found, but their own check failed: {certificate.reason}", value=certificate.gamma)
    return certificate


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
