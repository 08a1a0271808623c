"""Stability and performance of a loop with a failure process eta and a detection process r, each with its own clock (Chapter 4).

    dx = (A_i + B_i K S_i) x + E_i w,   y = C_i x,   i = eta,   k = r,   K = K(k, h_r): what the controller sees, of S_i x

    [ A_ik'P + P A_ik + sum_j lambda_ij (P_jk - P) + sum_l pi^(i)_kl (P_il - P) + C_i'G11 C_i      *   ]
    [ E_i'P + G21 C_i                                                                             G22  ] < 0

for P = P_ik(a, b), a the section of eta's clock and b that of r's, at all vertices of all rates of the pair of sections.
A jump of eta lands in (1, b), or in (1, 1) if it restarts r's clock; a jump of r lands in (a, 1); P falls where a clock
enters a new section. The printed (4.27) has one index for both clocks and couples neither: ``design.as_printed.chapters_2_to_4``.

References: thesis (4.6), (4.14), (4.23); ERRATA 11, 12 and 13.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.linalg import block_diag, eigh

from design.controllers.scheduled_gain import ScheduledGain
from design.errors import FieldError, Infeasible
from design.lmi import Attenuation, Lift, as_float, attenuation, decide
from design.lmi.program import Array, Inequality, LmiProgram, symmetric_blocks, symmetric_part, transpose
from design.processes.partitions import Partition
from design.processes.semi_markov import FaultDetection
from design.semi_markov_loop import FloatArray, JumpSystem
from design.semi_markov_loop.certificate import JumpCertificate, attenuation_certificate
from design.semi_markov_loop.period_moments import gain_mode, moment_operators
from design.semi_markov_loop.sojourn_grid import cells, pair_cells, pair_corners


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Siqc:
    """Stochastic integral quadratic constraint (4.6): E int [y; w]' [G11 G12; G12' G22] [y; w] < 0 for x(0) = 0, w != 0.

    Args:
        g11: positive definite, shape (p, p).
        g12: shape (p, q).
        g22: negative definite, shape (q, q).
    """

    g11: FloatArray
    g12: FloatArray
    g22: FloatArray

    def __post_init__(self) -> None:
        g11, g12, g22 = (np.array(m, dtype=float) for m in (self.g11, self.g12, self.g22))
        for name, matrix, sign in (("g11", g11, 1.0), ("g22", -g22, -1.0)):
            if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or not np.allclose(matrix, matrix.T):
                raise FieldError(name, f"shape {matrix.shape} or entries are not those of a symmetric matrix")
            smallest = np.linalg.eigvalsh(matrix)[0] if np.isfinite(matrix).all() else np.nan
            if not smallest > 0:
                kind = "positive" if sign > 0 else "negative"
                raise FieldError(name, f"eigenvalue {sign * smallest:g}, expected a {kind} definite matrix")
        if g12.shape != (g11.shape[0], g22.shape[0]) or not np.isfinite(g12).all():
            raise FieldError("g12", f"shape {g12.shape}, expected finite entries of shape {(g11.shape[0], g22.shape[0])}")
        for name, matrix in (("g11", g11), ("g12", g12), ("g22", g22)):
            object.__setattr__(self, name, matrix)

    @property
    def scale(self) -> float:
        """Factor on y and w that makes G22 of size one."""
        return float(1.0 / np.sqrt(np.linalg.norm(self.g22, 2)))


def check_loop(system: JumpSystem, process: FaultDetection, gain: ScheduledGain | None = None) -> None:
    """Raise ValueError unless system, processes and gains fit each other."""
    if system.c is None or system.e is None:
        raise FieldError("c" if system.c is None else "e", "is needed for a performance bound")
    if system.uncertainty is not None:
        raise FieldError("uncertainty", "is not covered by the two-process conditions")
    system.check(process, gain)
    if gain is not None and gain.schedule != "hold":
        raise FieldError("gain", "linear schedules are not covered by the two-process conditions, hold them")


def loop_inequalities(
    system: JumpSystem,
    process: FaultDetection,
    gain: ScheduledGain,
    eta_nodes: Partition,
    r_nodes: Partition,
    performance: Siqc | None,
    scale: float,
    lift: Lift = as_float,
) -> list[Inequality]:
    """Every inequality on P[i,k,a,b], K[mode,section] and, without a SIQC, g2 = (scale gamma)^2; y is scaled by ``scale``.

    Raises ValueError where a section of the gains starts inside a cell of ``r_nodes``: the cell would have one gain of several.
    """
    for k, row in enumerate(r_sections(process, gain)):
        missing = sorted(set(row) - set(r_nodes[k]))
        if missing:
            raise FieldError(f"r_nodes[{k}]", f"a section of the gains starts at {missing[0]:g} s, inside a cell")
    out = []
    for eta, r in pair_cells(process, eta_nodes, r_nodes):
        i, k, a, b = eta.mode, r.mode, eta.index, r.index
        own = f"P[{i},{k},{a},{b}]"
        mode = gain_mode(gain.measured, process, i, k)
        section = int(np.searchsorted(gain.starts_s[mode], r_nodes[k][b], side="right")) - 1
        for jumps in pair_corners(process, eta, r):
            rates = [rate for rate, _ in jumps]
            function = partial(
                _bounded_real, system=system, mode=i, rates=[lift(rate) for rate in rates], performance=performance,
                scale=scale, lift=lift,
            )  # fmt: skip
            landing = ("P[{},{},{},{}]".format(*place) for _, place in jumps)
            on = (own, f"K[{mode},{section}]", *(() if performance else ("g2",)), *landing)
            out.append(Inequality(name=f"{own} at rates {rates}", function=function, on=on))
        for last, later in ((eta.last, f"P[{i},{k},{a + 1},{b}]"), (r.last, f"P[{i},{k},{a},{b + 1}]")):
            if not last:
                out.append(Inequality(name=f"{later} <= {own}", function=lambda p, q: p - q, on=(later, own)))
        out.append(Inequality(name=f"{own} > 0", function=lambda p: -p, on=(own,)))
    return out


def _bounded_real(
    p: Array,
    k: Array,
    *rest: Array,
    system: JumpSystem,
    mode: int,
    rates: list[Array],
    performance: Siqc | None,
    scale: float,
    lift: Lift,
) -> Array:
    a, b, c, e = (lift(m[mode]) for m in (system.a, system.b, system.c, system.e) if m is not None)
    landing = rest[len(rest) - len(rates) :]
    loop = a + b @ k if system.sensors is None else a + b @ k @ lift(system.sensors[mode])
    value = symmetric_part(p @ loop) + sum((rate * (q - p) for rate, q in zip(rates, landing)), 0 * p)
    square = lift(scale) * lift(scale)
    if performance is None:
        g2 = rest[0]
        return symmetric_blocks([[value + square * (c.T @ c)], [transpose(p @ e), -g2 * lift(np.eye(e.shape[1]))]])
    g11, g12, g22 = (square * lift(m) for m in (performance.g11, performance.g12, performance.g22))
    return symmetric_blocks([[value + c.T @ g11 @ c], [transpose(p @ e) + g12.T @ c, g22]])


def _known(
    system: JumpSystem,
    process: FaultDetection,
    gain: ScheduledGain,
    eta_nodes: Partition,
    r_nodes: Partition,
    performance: Siqc | None,
    scale: float,
    gamma: float | None,
    lift: Lift = as_float,
) -> list[Inequality]:
    listed = loop_inequalities(system, process, gain, eta_nodes, r_nodes, performance, scale, lift)
    modes, sections = gain.gain.shape[:2]
    known = {f"K[{i},{s}]": lift(gain.gain[i, s]) for i in range(modes) for s in range(sections)}
    if gamma is not None:
        known["g2"] = lift([[(scale * gamma) ** 2]])
    return [item.fixing(known) for item in listed]


def r_sections(process: FaultDetection, gain: ScheduledGain) -> Partition:
    """For every detection mode the sections of r's clock on which no gain changes."""
    out = []
    for k in range(process.detection[0].modes):
        rows = {gain_mode(gain.measured, process, i, k) for i in range(process.failure.modes)}
        out.append(tuple(sorted({float(start) for row in rows for start in gain.starts_s[row]})))
    return tuple(out)


def analyse_fault_tolerant(
    system: JumpSystem,
    gain: ScheduledGain,
    process: FaultDetection,
    *,
    eta_nodes: Partition | None = None,
    r_nodes: Partition | None = None,
    performance: Siqc | None = None,
    gamma: float | None = None,
) -> JumpCertificate:
    """The smallest certified gamma of given gains (or the verdict at a given gamma, or on a SIQC).

    Args:
        gain: K by what is measured: ("r",), ("eta", "r") with index eta * N_r + r, or () for one blind gain; sections on r's
            clock.
        eta_nodes, r_nodes: sections of both clocks for P; by default one for eta. Those of r are cut where a section of the
            gains starts.

    Returns:
        The certificate. Without sections, gains whose second moments grow at constant rates within the bounds are ``refused``.

    Raises:
        ValueError: data that do not fit.
    """
    check_loop(system, process, gain)
    eta = eta_nodes if eta_nodes is not None else ((0.0,),) * system.modes
    own = r_sections(process, gain)
    r = own if r_nodes is None else tuple(tuple(sorted({*row, *cut})) for row, cut in zip(r_nodes, own, strict=True))
    rebuild = partial(_known, system, process, gain, eta, r, performance)
    assumptions = ("rates anywhere in their bounds on every pair of sections", "x(0) = 0 for the performance bound")

    def build(scale: float) -> LmiProgram:
        program = LmiProgram()
        for one, two in pair_cells(process, eta, r):
            program.symmetric(f"P[{one.mode},{two.mode},{one.index},{two.index}]", system.states)
        if performance is None:
            program.matrix("g2", 1, 1)
        program.inequalities = rebuild(scale, None)
        return program

    alone = max(gain.gain.shape[1], *map(len, (*eta, *r))) == 1  # else no section may allow the rates of that growth together
    growth = worst_growth(system, gain, process) if alone else None
    if growth is not None and growth[0] >= 0:
        reason = f"second moments grow like e^({growth[0]:.4g} t) at constant rates within the bounds: {growth[1]}"
        return JumpCertificate(
            method="exact", verdict="refused", reason=reason, gain=gain, decay_rate=-growth[0],
            assumptions=assumptions[:1],
        )  # fmt: skip
    what = "fault-tolerant loop"

    def siqc(met: Siqc) -> Attenuation:
        found = decide(build(met.scale))
        if not found.holds:
            raise Infeasible(f"{what}, SIQC: {found.explain()}", value=found.margin, proved=found.refused)
        return Attenuation(gamma=None, scale=met.scale, found=found)

    certificate = attenuation_certificate(
        partial(attenuation, build, what, gamma) if performance is None else partial(siqc, performance), method="pwc",
        gain=gain, assumptions=assumptions, rebuild=rebuild,
    )  # fmt: skip
    if not certificate.certified:
        return certificate
    return replace(certificate, decay_rate=proved_decay(system, process, gain, eta, r, certificate.matrices))


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
