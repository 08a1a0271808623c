"""Is a semi-Markov jump linear loop mean-square stable? Chapter 2's question, by four methods.

    V = x' P_i(h) x decreases on average if, for every cell, rate vertex and uncertainty,
    A_i(h)'P_i + P_i A_i(h) + dP_i/dh + sum_j lambda_ij (P_j(0) - P_i) + alpha P_i < 0,        A_i(h) = A_i + B_i K(i, h)

- ``pwl``: P_i linear between nodes, constant after the last one.
- ``pwc``: P_i constant per section; jumps land in section 1 and see P_j(0), and P_{i,m+1} <= P_{i,m} at boundaries.
- ``exact``: spectral radius of the per-jump second-moment operator (``second_moments``); certain systems only.

References: thesis (2.4), (2.12)-(2.15); ERRATA 1 and 3 (one multiplier for F_A + F_B K).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from design.controllers.scheduled_gain import ScheduledGain, constant_gain
from design.errors import FieldError, check_at_least_zero
from design.lmi import Lift, VerifyWith, as_float, decide
from design.lmi.program import (
    Array,
    Inequality,
    LmiProgram,
    largest_eigenvalue,
    symmetric_blocks,
    symmetric_part,
    transpose,
    verify,
)
from design.processes.partitions import Partition
from design.processes.semi_markov import SemiMarkov
from design.semi_markov_loop import JumpSystem, NormBounded
from design.semi_markov_loop.certificate import JumpCertificate, Method
from design.semi_markov_loop.second_moments import exact_certificate
from design.semi_markov_loop.sojourn_grid import Cell, along_cells, refine

CONDITION = 1e4
"""Largest condition number of the Lyapunov matrices, or of X, that is searched (P >= I, P <= CONDITION I)."""


def stability_inequalities(
    system: JumpSystem,
    gain: ScheduledGain,
    process: SemiMarkov,
    nodes: Partition,
    method: Method,
    decay: float,
    lift: Lift = as_float,
    sound: bool = True,
) -> list[Inequality]:
    """Every inequality of ``pwl`` or ``pwc`` on P[i,r] (and eps[i,r]), for floats or fractions."""
    bounded = isinstance(system.uncertainty, NormBounded)
    changes = [partial(_decrease, system=system, vertex=vertex, decay=decay, lift=lift) for vertex in system.vertices]
    at_nodes = ("P", "eps") if bounded else ("P",)
    return along_cells(
        changes, process, gain, nodes, method, at_nodes=at_nodes, least=lift(np.eye(system.states)), sound=sound, lift=lift
    )


def _decrease(
    cell: Cell, k: Array, flow: Array, p: Array, *eps: Array, system: JumpSystem, vertex: int | None, decay: float, lift: Lift
) -> Array:
    """The left side of the decrease condition at K and P; ``flow``: what P itself changes by."""
    i, uncertainty = cell.mode, system.uncertainty
    a, b = system.at(i, vertex, lift)
    value = symmetric_part(p @ (a + b @ k)) + flow + lift(decay) * p
    if not isinstance(uncertainty, NormBounded):
        return np.asarray(value)
    e, f = lift(uncertainty.e[i]), lift(uncertainty.fa[i]) + lift(uncertainty.fb[i]) @ k
    one, two = lift(np.eye(e.shape[1])), lift(np.eye(f.shape[-2]))
    return symmetric_blocks([[value], [transpose(p @ e), -eps[0] * one], [eps[0] * f, None, -eps[0] * two]])


def lyapunov_program(inequalities: list[Inequality], states: int, condition: float) -> LmiProgram:
    """The program over the P and eps of the inequalities, all bounded by ``condition``."""
    program = LmiProgram(reach=condition)
    for name in dict.fromkeys(name for item in inequalities for name in item.on):
        program.symmetric(name, 1 if name.startswith("eps") else states, most=condition)
    program.inequalities += inequalities
    return program


def analyse(
    system: JumpSystem,
    gain: ScheduledGain | None,
    process: SemiMarkov,
    *,
    method: Method = "pwl",
    nodes: Partition | None = None,
    parts: int = 4,
    decay: float = 0.0,
    condition: float = CONDITION,
    verify_with: VerifyWith = "cvxpy",
) -> JumpCertificate:
    """Certify or refuse mean-square stability of the loop u = K(i, h) x, with decay rate at least ``decay``.

    Args:
        system: matrices and uncertainty.
        gain: K(i, h), or None for u = 0.
        process: the rates.
        method: see the module.
        nodes: Lyapunov nodes (``pwl``) or sections (``pwc``) per mode; by default the section
            starts of the gains, for ``pwl`` with the kinks of the rates, each gap cut into ``parts``.
        decay: demanded decay rate of E|x|^2 (1/s).
        condition: largest condition number of P that is searched.
        verify_with: who is asked where our solver leaves a doubt (seconds), see `design.lmi`.

    Returns:
        The certificate; its ``decay_rate`` is the largest that the returned matrices prove.

    Raises:
        ValueError: shapes that do not fit, nodes that split a section, rates without finite bounds.
    """
    gain = checked_gain(system, gain, process)
    check_at_least_zero(decay=decay)
    if method == "exact":
        return exact_certificate(system, gain, process)
    if method not in ("pwl", "pwc"):
        raise FieldError("method", f"{method!r} is not one of exact, pwl, pwc")
    if nodes is None:
        starts = tuple(tuple(row.tolist()) for row in gain.starts_s)
        nodes = refine(process, starts, parts) if method == "pwl" else starts
    form = f"method {method}, I <= P <= {condition:g} I" + (f", decay {decay:g}/s" if decay else "")
    found = stability_certificate(system, gain, process, nodes, method, decay, condition, form, verify_with=verify_with)
    if not found.certified:
        return found
    rebuilt = partial(stability_inequalities, system, gain, process, nodes, method)
    return replace(found, decay_rate=_proved_decay(rebuilt, found.matrices, decay))


def stability_certificate(
    system: JumpSystem,
    gain: ScheduledGain,
    process: SemiMarkov,
    nodes: Partition,
    method: Method,
    decay: float,
    condition: float,
    form: str,
    *,
    sound: bool = True,
    verify_with: VerifyWith = "cvxpy",
) -> JumpCertificate:
    """What the inequalities at one decay rate say, with matrices I <= P <= ``condition`` I; ``form`` begins the reason."""
    rebuild = partial(stability_inequalities, system, gain, process, nodes, method, decay, sound=sound)
    found = decide(lyapunov_program(rebuild(as_float), system.states, condition), verify_with=verify_with)
    return JumpCertificate(
        method=method, reason=f"{form}: {found.explain()}", margin=found.margin, verdict=found.verdict,
        matrices=found.matrices, assumptions=("rates anywhere in their bounds on every cell",), gain=gain, rebuild=rebuild,
        solver=found.solver,
    )  # fmt: skip


def checked_gain(system: JumpSystem, gain: ScheduledGain | None, process: SemiMarkov) -> ScheduledGain:
    """The gain, or zero gains for None. Raises ValueError unless system, gain and process fit each other."""
    system.check(process, gain)
    return constant_gain(np.zeros((system.modes, system.inputs, system.states))) if gain is None else gain


def _proved_decay(build: Callable[[float], list[Inequality]], matrices: Mapping[str, Array], low: float) -> float:
    """The largest decay rate at which the same matrices still fulfil every strict inequality (bisection).

    The inequalities are affine in the decay rate: they are built at two rates, and the result is verified as it stands.
    """
    ends = [[item.at(matrices) for item in build(decay) if item.strict] for decay in (low, low + 1.0)]
    stacks: dict[tuple[int, ...], list[tuple[Array, Array]]] = {}
    for here, there in zip(*ends):
        stacks.setdefault(here.shape, []).append((here, there - here))
    parts = [(np.array([at for at, _ in pairs]), np.array([slope for _, slope in pairs])) for pairs in stacks.values()]

    def holds(decay: float) -> bool:
        return all(largest_eigenvalue(at + (decay - begun) * slope) < 0 for at, slope in parts)

    begun, high = low, low + 1.0
    while holds(high):
        low, high = high, 2.0 * high
    for _ in range(20):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if holds(middle) else (low, middle)
    while low > begun and verify(build(low), matrices)[0] <= 0:  # rounding only
        low = max(begun, low - (high - low))
    return low


def largest_decay(
    system: JumpSystem,
    gain: ScheduledGain | None,
    process: SemiMarkov,
    *,
    nodes: Partition | None = None,
    parts: int = 4,
    tolerance: float = 1e-3,
) -> JumpCertificate:
    """The certificate with the largest decay rate of the method ``pwl``, by bisection to a relative ``tolerance``.

    Raises ValueError as ``analyse``; where not even stability is certified, the certificate at decay 0 comes back.
    """
    best = analyse(system, gain, process, nodes=nodes, parts=parts)
    if not best.certified:
        return best
    low, high = best.decay_rate or 0.0, np.inf
    while high - low > tolerance * max(low, 1e-3):
        decay = 2.0 * low + 0.1 if np.isinf(high) else 0.5 * (low + high)
        trial = analyse(system, gain, process, nodes=nodes, parts=parts, decay=decay, verify_with="nothing")
        if trial.certified and trial.decay_rate is not None:
            best, low = trial, max(trial.decay_rate, decay)
        else:
            high = decay
    return best
