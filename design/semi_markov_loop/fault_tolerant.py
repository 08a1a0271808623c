"""Fault-tolerant state feedback that needs only what the controller sees (Chapter 4).

The thesis' conditions give K_ik, but the fault i is not measured: only the detection k = r and its clock are. Used as K_kk, the
printed gains (4.30) diverge. Here:

1. start: X shared by all (i, a) that the controller cannot tell apart, so that K = R X^-1 depends on what it sees alone;
2. alternate: with K known the conditions are linear in P; with P known they are linear in K and its norm bound.

Where sensors fail, K S_i takes the place of K. The start knows sound sensors alone; they then fail by and by, with a step of K
after each part, as long as the loop stays certified.

Both steps lower gamma, neither can raise it. ``measured``: ("r",) (default), () for one blind gain, ("eta", "r") if the
fault is known. Without a gain bound the infimum of gamma is 0, so a bound is required.

References: thesis (4.21), (4.26); ERRATA 11, 12 and 13.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from functools import partial

import numpy as np

from design.controllers.scheduled_gain import ScheduledGain
from design.errors import FieldError, Infeasible
from design.lmi import decide, smallest_gamma
from design.lmi.program import Array, LmiProgram, add_schur_rows, check_gain_bound, symmetric_blocks, symmetric_part, transpose
from design.processes.partitions import Partition
from design.processes.semi_markov import FaultDetection
from design.semi_markov_loop import JumpSystem
from design.semi_markov_loop.certificate import JumpCertificate, check_stabilisable
from design.semi_markov_loop.fault_tolerant_analysis import (
    Siqc,
    analyse_fault_tolerant,
    check_loop,
    loop_inequalities,
    r_sections,
)
from design.semi_markov_loop.period_moments import gain_mode
from design.semi_markov_loop.sojourn_grid import bounded_gains, pair_cells, pair_corners

Measured = tuple[str, ...]
FAILING = (0.0, 0.25, 0.5, 0.75, 0.9, 1.0)
"""Shares of what the sensors lose, one after the other."""


def _failed(system: JumpSystem, share: float) -> JumpSystem:
    """The system whose sensors have lost a share of what they lose."""
    if system.sensors is None or share == 1.0:
        return system
    return replace(system, sensors=np.eye(system.states) + share * (system.sensors - np.eye(system.states)))


def _start_program(
    system: JumpSystem,
    process: FaultDetection,
    measured: Measured,
    sections: Partition,
    gain_bound: float,
    performance: Siqc | None,
    scale: float,
) -> LmiProgram:
    """The X form of (4.26), vertex by vertex, on X[mode,section], R[mode,section], s and g2."""
    program = LmiProgram()
    program.matrix("s", 1, 1)
    if performance is None:
        program.matrix("g2", 1, 1)
    for eta, r in pair_cells(process, ((0.0,),) * system.modes, sections):
        mode = gain_mode(measured, process, eta.mode, r.mode)
        x, u = f"X[{mode},{r.index}]", f"R[{mode},{r.index}]"
        if x not in program.variables:
            program.symmetric(x, system.states)
            program.bounded_gain(x, u, system.inputs, gain_bound)
            if not r.last:
                program.require("coupling", lambda p, q: q - p, f"X[{mode},{r.index + 1}]", x, strict=False)
        for jumps in pair_corners(process, eta, r):
            named = [(rate, f"X[{gain_mode(measured, process, i, k)},{b}]") for rate, (i, k, _, b) in jumps]
            named = [(rate, name) for rate, name in named if name != x]  # a jump to the same X changes nothing
            rates = [rate for rate, _ in named]
            function = partial(
                inverse_block, system=system, mode=eta.mode, leaving=sum(rates), rates=rates, performance=performance, scale=scale
            )
            on = (x, u, *(() if performance else ("g2",)), *(name for _, name in named))
            program.require(f"{x} at {[rate for rate, _ in jumps]}", function, *on)
    return program


def inverse_block(
    x: Array,
    r: Array,
    *rest: Array,
    system: JumpSystem,
    mode: int,
    leaving: float,
    rates: list[float],
    scale: float,
    performance: Siqc | None = None,
) -> Array:
    """The left side of (4.26) in X = P^-1 and R = K X; ``rest``: g2 without a SIQC, then the X that jumps land in."""
    a, b, c, e = (m[mode] for m in (system.a, system.b, system.c, system.e) if m is not None)
    landing = rest[len(rest) - len(rates) :]
    rows: list[list[Array | None]] = [[symmetric_part(a @ x + b @ r) - leaving * x]]
    if performance is None:
        rows += [[e.T, -rest[0] * np.eye(e.shape[1])], [scale * (c @ x), None, -np.eye(c.shape[0])]]
    else:
        cross, corner = scale * scale * performance.g12.T, scale * scale * performance.g22
        rows += [[cross @ (c @ x) + e.T, corner], [scale * (c @ x), None, -np.linalg.inv(performance.g11)]]
    add_schur_rows(rows, (math.sqrt(rate) * x for rate in rates), landing)
    return symmetric_blocks(rows)


def _gain_step(
    system: JumpSystem, process: FaultDetection, gain: ScheduledGain, certificate: JumpCertificate, eta: Partition, bound: float
) -> ScheduledGain:
    """The gains of smallest gamma for the Lyapunov matrices of a certificate of other gains."""
    program = LmiProgram()
    program.matrix("g2", 1, 1)
    table = [[f"K[{mode},{section}]" for section in range(gain.gain.shape[1])] for mode in range(gain.modes)]
    for name in itertools.chain(*table):
        program.matrix(name, system.inputs, system.states)
        program.require(f"norm of {name}", partial(_norm_limit, bound=bound), name, strict=False)
    listed = loop_inequalities(system, process, gain, eta, r_sections(process, gain), None, certificate.scale)
    for item in listed:
        if any(name.startswith("K") for name in item.on):
            program.inequalities.append(item.fixing(certificate.matrices))
    found = program.solve("g2")
    new = np.array([[found.matrices[name] for name in row] for row in table])
    norms = np.linalg.norm(new, ord=2, axis=(-2, -1), keepdims=True)
    return replace(gain, gain=new * np.minimum(1.0, bound / norms))


def _norm_limit(k: Array, bound: float) -> Array:
    return -symmetric_blocks([[bound * np.eye(k.shape[-2])], [transpose(k), bound * np.eye(k.shape[-1])]])


def fault_tolerant_feedback(
    system: JumpSystem,
    process: FaultDetection,
    *,
    gain_bound: float,
    measured: Measured = ("r",),
    sections: Partition | None = None,
    eta_nodes: Partition | None = None,
    gamma: float | None = None,
    performance: Siqc | None = None,
    rounds: int = 8,
) -> JumpCertificate:
    """Gains K(what is measured, section of r's clock) with the smallest certified gamma under a gain bound.

    Args:
        gain_bound: largest spectral norm of any gain.
        measured: ("r",), () or ("eta", "r"), see the module.
        sections: sections of r's clock per detection mode, by default one.
        eta_nodes: sections of eta's clock for P.
        gamma: stop as soon as this level is certified.
        performance: a SIQC (4.6) to meet instead of gamma.
        rounds: largest number of alternations; they end when gamma falls by less than 1e-3 per round.

    Returns:
        The certificate of the gains (``.gain``), found again from the gains alone.

    Raises:
        ValueError: data that do not fit.
        Infeasible: no start could be found, or ``gamma`` was not reached; the message says how far.
    """
    check_loop(system, process)
    check_gain_bound(gain_bound)
    check_stabilisable(system, process.failure)
    if measured not in ((), ("r",), ("eta", "r")):
        raise FieldError("measured", f"{measured!r} is not (), ('r',) or ('eta', 'r')")
    detections = process.detection[0].modes
    parts = sections if sections is not None else ((0.0,),) * detections
    if measured == () and max(len(row) for row in parts) > 1:
        raise FieldError("sections", "a controller without detection has no clock for its schedule")
    eta = eta_nodes if eta_nodes is not None else ((0.0,),) * system.modes
    build = partial(_start_program, system, process, measured, parts, gain_bound, performance)
    what = f"fault-tolerant feedback with gain norm <= {gain_bound:g}, measured {measured}"
    if performance is not None:
        found = decide(build(performance.scale))
        if not found.holds:
            raise Infeasible(f"{what}, SIQC, X shared by what is not distinguished: {found.explain()}", value=found.margin)
    else:
        found = smallest_gamma(build, what).found
    modes = {(): 1, ("r",): detections, ("eta", "r"): system.modes * detections}[measured]
    rows = tuple(parts[mode % detections] for mode in range(modes))
    gain = bounded_gains(found.matrices, "R", rows, gain_bound, measured)
    for share in (1.0,) if system.sensors is None or performance is not None else FAILING:
        failing = _failed(system, share)
        best = analyse_fault_tolerant(failing, gain, process, eta_nodes=eta, performance=performance)
        if best.certified and share < 1.0:
            gain = _gain_step(failing, process, gain, best, eta, gain_bound)
    if not best.certified:
        raise Infeasible(f"{what}: gains found, but their own check failed: {best.reason}")
    if performance is not None:
        return best
    for _ in range(rounds):
        level = best.gamma or math.inf
        if gamma is not None and level <= gamma:
            break
        gain = _gain_step(system, process, gain, best, eta, gain_bound)
        trial = analyse_fault_tolerant(system, gain, process, eta_nodes=eta)
        if not trial.certified or (trial.gamma or math.inf) >= level:
            break
        best = trial
        if (best.gamma or 0.0) > level * (1.0 - 1e-3):
            break
    if gamma is not None and (best.gamma or math.inf) > gamma:
        raise Infeasible(
            f"{what}: gamma = {best.gamma:.4g} was certified, {gamma:g} was asked; not proved to be the best",
            value=best.gamma,
        )
    return best
