"""Is a semi-Markov jump linear loop mean-square stable? Chapter 2's question, by four methods.

    V = x' P_i(h) x decreases on average if, for every cell, rate vertex and uncertainty,
    A_i(h)'P_i + P_i A_i(h) + dP_i/dh + sum_j lambda_ij (P_j(0) - P_i) + alpha P_i < 0,        A_i(h) = A_i + B_i K(i, h)

- ``pwl``: P_i linear between nodes, constant after the last one.
- ``pwc``: P_i constant per section; jumps land in section 1 and see P_j(0), and P_{i,m+1} <= P_{i,m} at boundaries.
- ``exact``: spectral radius of the per-jump second-moment operator (``second_moments``); certain systems only.

References: thesis (2.4), (2.12)-(2.15); ERRATA 1 and 3 (one multiplier for F_A + F_B K).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import cast

import numpy as np

from design.controllers.scheduled_gain import ScheduledGain, constant_gain
from design.errors import FieldError
from design.lmi.decision import VerifyWith, decide
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
from design.semi_markov_loop.certificate import JumpCertificate, Method
from design.semi_markov_loop.second_moments import exact_certificate
from design.semi_markov_loop.sojourn_grid import SOUND, Cell, Coupling, Lift, as_float, bernstein, cells, gain_on, refine
from design.semi_markov_loop.system import JumpSystem, NormBounded, VertexUncertainty

CONDITION = 1e4
"""Largest condition number of the Lyapunov matrices that is searched (P >= I, P <= CONDITION I)."""


def stability_inequalities(
    system: JumpSystem,
    gain: ScheduledGain,
    process: SemiMarkov,
    nodes: Partition,
    method: Method,
    decay: float,
    lift: Lift = as_float,
    coupling: Coupling = SOUND,
) -> list[Inequality]:
    """Every inequality of ``pwl`` or ``pwc`` on P[i,r], K[i,s] (and eps[i,r]), for floats or fractions.

    They are affine in all P and eps for known K, and in all K for known P and eps. Of ``gain`` only the sections count.
    """
    out = []
    bounded = isinstance(system.uncertainty, NormBounded)
    for cell in cells(process, nodes, all_corners=coupling.all_corners):
        i, here = cell.mode, cell.index
        mixture = gain_on(gain.starts_s[i], gain.schedule, cell)
        pwl = method == "pwl" and not cell.last
        if mixture.moves and not pwl:
            raise FieldError("gain", f"varies within the section at {cell.start:g} s; only method 'pwl' can follow it")
        ends = [here, here + 1] if pwl else [here]
        own = [f"P[{i},{r}]" for r in ends] + ([f"eps[{i},{r}]" for r in ends] if bounded else [])
        gains = [f"K[{i},{s}]" for s in mixture.sections]
        checks = bernstein(mixture) if pwl else [[(0, mixture.weights[0])]]
        for rates in cell.rates:
            targets = [j for j, rate in enumerate(rates) if rate > 0]
            landing = [f"P[{j},{coupling.landing(here, len(nodes[j]))}]" for j in targets]
            for pairs in checks:
                for vertex in system.vertices:
                    function = partial(
                        _decrease, system=system, cell=cell, vertex=vertex, ends=len(ends), pairs=pairs,
                        rates=[lift(rates[j]) for j in targets], decay=decay, lift=lift,
                    )  # fmt: skip
                    name = f"decrease of mode {i} on [{cell.start:g}, {cell.stop:g}) s at rates {rates}"
                    out.append(Inequality(name=name, function=function, on=(*own, *landing, *gains)))
        if method == "pwc" and coupling.linked and not cell.last:
            both = (f"P[{i},{here + 1}]", f"P[{i},{here}]")
            out.append(Inequality(name="{} <= {}".format(*both), function=lambda a, b: a - b, on=both))
        identity = lift(np.eye(system.states))
        name = f"P[{i},{here}]"
        out.append(Inequality(name=f"{name} >= I", function=lambda p, one=identity: one - p, on=(name,), strict=False))
    return out


def gain_matrices(gain: ScheduledGain, lift: Lift = as_float) -> dict[str, Array]:
    """The stored gains under the names that the inequalities use."""
    modes, sections = gain.gain.shape[:2]
    return {f"K[{i},{s}]": lift(gain.gain[i, s]) for i in range(modes) for s in range(sections)}


def _decrease(
    *matrices: Array,
    system: JumpSystem,
    cell: Cell,
    vertex: int | None,
    ends: int,
    pairs: list[tuple[int, tuple[float, ...]]],
    rates: list[Array],
    decay: float,
    lift: Lift,
) -> Array:
    """The left side of the decrease condition at one Bernstein coefficient; ``matrices``: P, eps, landings, gains."""
    i, uncertainty = cell.mode, system.uncertainty
    bounded = isinstance(uncertainty, NormBounded)
    p, rest = matrices[:ends], matrices[ends:]
    eps, rest = (rest[:ends], rest[ends:]) if bounded else ((), rest)
    landing, gains = rest[: len(rates)], rest[len(rates) :]
    slope = (p[1] - p[0]) / (lift(cell.stop) - lift(cell.start)) if ends == 2 else 0 * p[0]
    a, b = lift(system.a[i]), lift(system.b[i])
    if vertex is not None:
        uncertainty = cast(VertexUncertainty, uncertainty)
        a, b = a + lift(uncertainty.da[vertex, i]), b + lift(uncertainty.db[vertex, i])
    terms = []
    for end, weights in pairs:
        here = p[end]
        k = sum(lift(weight) * stored for weight, stored in zip(weights, gains))
        value = symmetric_part(here @ (a + b @ k)) + slope + lift(decay) * here
        value = value + sum(rate * (after - here) for rate, after in zip(rates, landing))
        if bounded:
            uncertainty = cast(NormBounded, uncertainty)
            e, f = lift(uncertainty.e[i]), lift(uncertainty.fa[i]) + lift(uncertainty.fb[i]) @ k
            one, two = lift(np.eye(e.shape[1])), lift(np.eye(f.shape[-2]))
            value = symmetric_blocks([[value], [transpose(here @ e), -eps[end] * one], [eps[end] * f, None, -eps[end] * two]])
        terms.append(value)
    return cast(Array, sum(terms[1:], terms[0]) / lift(len(terms)))


def lyapunov_program(inequalities: list[Inequality], states: int, condition: float) -> LmiProgram:
    """The program over the P and eps of the inequalities, all bounded by ``condition``."""
    program = LmiProgram(reach=condition)
    for name in dict.fromkeys(name for item in inequalities for name in item.on):
        if name.startswith("eps"):
            program.matrix(name, 1, 1)
            program.require(f"{name} bounded", lambda e: e - condition, name, strict=False)
        else:
            program.symmetric(name, states)
            bound = condition * np.eye(states)
            program.require(f"{name} bounded", lambda p, top=bound: p - top, name, strict=False)
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
        verify_with: who is asked where our solver leaves a doubt (seconds), see `design.lmi.decision`.

    Returns:
        The certificate; its ``decay_rate`` is the largest that the returned matrices prove.

    Raises:
        ValueError: shapes that do not fit, nodes that split a section, rates without finite bounds.
    """
    gain = checked_gain(system, gain, process)
    if not np.isfinite(decay) or decay < 0:
        raise FieldError("decay", f"{decay!r} is not a finite non-negative rate")
    if method == "exact":
        return exact_certificate(system, gain, process)
    if method not in ("pwl", "pwc"):
        raise FieldError("method", f"{method!r} is not one of exact, pwl, pwc")
    if nodes is None:
        starts = tuple(tuple(row.tolist()) for row in gain.starts_s)
        nodes = refine(process, starts, parts) if method == "pwl" else starts
    rebuild = partial(known_gain, system, gain, process, nodes, method, decay)
    program = lyapunov_program(rebuild(as_float), system.states, condition)
    found = decide(program, verify_with=verify_with)
    certified = found.holds
    form = f"method {method}, I <= P <= {condition:g} I" + (f", decay {decay:g}/s" if decay else "")
    proved = None
    if certified:
        proved = _proved_decay(partial(known_gain, system, gain, process, nodes, method), found.matrices, decay)
    assumptions = ("rates anywhere in their bounds on every cell",)
    return JumpCertificate(
        method=method, sound=True, reason=f"{form}: {found.explain()}", margin=found.margin,
        verdict="certified" if certified else "refused" if found.refused else "undecided", matrices=found.matrices,
        assumptions=assumptions, decay_rate=proved, gain=gain,
        rebuild=rebuild, solver=found.solver,
    )  # fmt: skip


def checked_gain(system: JumpSystem, gain: ScheduledGain | None, process: SemiMarkov) -> ScheduledGain:
    """The gain, or zero gains for None. Raises ValueError unless system, gain and process fit each other."""
    if process.modes != system.modes:
        raise FieldError("process", f"{process.modes} modes, the system has {system.modes}")
    if gain is None:
        return constant_gain(np.zeros((system.modes, system.inputs, system.states)))
    expected = (system.modes, system.inputs, system.states)
    got = (gain.modes, *gain.gain.shape[2:])
    if got != expected:
        raise FieldError("gain", f"(modes, inputs, states) = {got}, the system has {expected}")
    return gain


def known_gain(
    system: JumpSystem,
    gain: ScheduledGain,
    process: SemiMarkov,
    nodes: Partition,
    method: Method,
    decay: float,
    lift: Lift = as_float,
    coupling: Coupling = SOUND,
) -> list[Inequality]:
    """``stability_inequalities`` with the gains put in: on P and eps only."""
    known = gain_matrices(gain, lift)
    listed = stability_inequalities(system, gain, process, nodes, method, decay, lift, coupling)
    return [item.fixing(known) for item in listed]


def _proved_decay(build: Callable[[float], list[Inequality]], matrices: dict[str, Array], low: float) -> float:
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
