"""The conditions of Chapters 2 to 4 as they are printed. NOT SOUND with sections; kept to be compared with.

Corollaries 2.1 and 2.2, ``printed_stability`` and ``PrintedRequest``: section m sees P_j, and X_j, in its own section m (jumps
land in section 1), sections are not linked; of the box of rates only "all low" and "all high" are tested, and the uncertainties
of A and B have a multiplier each.

``delayed_section``, (3.42) and (3.41), in one of two readings:

- ``literal``: (3.42) as it stands: off-diagonal rates in {low, high} against -low P_j on the diagonal, the same for 1 + eta tau.
- ``consistent``: (3.41) with one rate in both places, the only reading at which the published gains fit gamma = 0.93.

Both keep C'C and B'P, which belong to P coordinates, in an inequality in X = P^-1 coordinates (the condition is then the bounded
real lemma of (A', B, C)), let jumps land in the same section, link no sections, and give each section its own Q and eta.

``detection_section``, (4.26) and (4.27): they give K_ik, which needs the fault i; upper off-diagonal rates stand with lower
diagonal ones (sound, but loose); (4.27) has one section index m for two clocks, tests only the pairs (m, m) and links no
sections.

References: thesis (2.12)-(2.15), (2.18)-(2.21), (3.27), (3.40)-(3.42), (4.18)-(4.20), (4.26), (4.27); ERRATA 1 to 3, 9 to 13.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Literal

import numpy as np
from msgspec import Struct

from design.controllers.scheduled_gain import ScheduledGain
from design.errors import Infeasible
from design.lmi import attenuation, decide
from design.lmi.program import Array, LmiProgram, LmiSolution, add_schur_rows, symmetric_blocks, symmetric_part
from design.processes.partitions import Partition, equal_probability
from design.processes.semi_markov import FaultDetection, SemiMarkov
from design.semi_markov_loop import DelayedJumpSystem, JumpSystem
from design.semi_markov_loop.certificate import JumpCertificate, attenuation_certificate
from design.semi_markov_loop.fault_tolerant import inverse_block
from design.semi_markov_loop.fault_tolerant_analysis import check_loop
from design.semi_markov_loop.robust_feedback import feedback_program, tabulate
from design.semi_markov_loop.stability import CONDITION, checked_gain, stability_certificate

Reading = Literal["literal", "consistent"]
LARGEST = 1e6
"""Largest norm of gains that are left free without a bound."""


def _program(
    system: JumpSystem | DelayedJumpSystem,
    conditions: Mapping[str, Sequence[tuple[Callable[..., Array], Sequence[str]]]],
    shared: Sequence[str],
    gains: Mapping[str, Array] | None,
    gain_bound: float,
    scale: float,
) -> LmiProgram:
    """A condition per place and corner of the rates: a block on X and U = K X there, the shared matrices and X where jumps land.

    The gains are given by place, or left free within their bound.
    """
    program = LmiProgram()
    program.matrix("g2", 1, 1)
    if gains is None:
        program.matrix("s", 1, 1)
    if "Q" in shared:
        program.symmetric("Q", system.states)
        program.require("Q > 0", lambda q: -q, "Q")
    for place in conditions:
        x = f"X[{place}]"
        program.symmetric(x, system.states)
        program.require(f"{x} > 0", lambda v: -v, x)
        if gains is None:
            program.bounded_gain(x, f"U[{place}]", system.inputs, min(gain_bound, LARGEST))
    for place, corners in conditions.items():
        for block, landing in corners:
            on = (*shared, *(f"X[{other}]" for other in landing))
            if gains is None:
                program.require(place, partial(block, scale=scale), f"X[{place}]", f"U[{place}]", *on)
            else:
                known = partial(_with_gain, block=partial(block, scale=scale), gain=gains[place])
                program.require(place, known, f"X[{place}]", *on)
    return program


def _with_gain(x: Array, *rest: Array, block: Callable[..., Array], gain: Array) -> Array:
    return block(x, gain @ x, *rest)


def _corners(
    system: DelayedJumpSystem, low: Array, high: Array, mode: int, reading: Reading
) -> Iterator[tuple[Callable[..., Array], list[str]]]:
    tau = system.delay_max_s
    etas = float(low.sum(axis=1).max()), float(high.sum(axis=1).max())
    targets = [j for j in range(system.modes) if high[mode, j] > 0]
    for rates in itertools.product(*(sorted({float(low[mode, j]), float(high[mode, j])}) for j in targets)):
        for eta in sorted(set(etas)):
            total, divisors, held = sum(rates), rates, (1.0 + eta * tau, 1.0 + eta * tau)
            if reading == "literal":
                total, held = float(low[mode].sum()), (1.0 + eta * tau, 1.0 + etas[0] * tau)
                divisors = tuple(float(low[mode, j]) for j in targets)
            pairs = list(zip(rates, divisors))
            block = partial(_delayed_block, system=system, mode=mode, total=total, pairs=pairs, held=held)
            yield block, [str(j) for j in targets]


def _delayed_block(
    x: Array,
    u: Array,
    g2: Array,
    q: Array,
    *landing: Array,
    system: DelayedJumpSystem,
    mode: int,
    total: float,
    pairs: list[tuple[float, float]],
    held: tuple[float, float],
    scale: float,
) -> Array:
    """(3.42) at one corner.

    Args:
        total: rate on the diagonal (1/s).
        pairs: rate in the row and rate on the diagonal of every X that jumps land in (1/s).
        held: the same for 1 + eta tau.
    """
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


def delayed_section(
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
    modes = range(system.modes)
    low, high = (np.array(side) for side in zip(*(process.bounds(i, edges[i][m], edges[i][m + 1]) for i in modes)))
    conditions = {str(i): list(_corners(system, low, high, i, reading)) for i in modes}
    gains = None if gain is None else {str(i): gain.at(i, edges[i][m]) for i in modes}
    build = partial(_program, system, conditions, ("g2", "Q"), gains, gain_bound)
    return attenuation_certificate(
        partial(attenuation, build, f"printed Corollary 3.2 ({reading}), section {m + 1}", gamma), method="printed", gain=gain,
        assumptions=("C'C and B'P may stand in X coordinates (false)", "sections need no link (false)"),
    )  # fmt: skip


def free_gains(certificate: JumpCertificate, places: Iterable[str]) -> Array:
    """K = U X^-1 of every place ("i", or "i,k"), (places, m, n), of a section whose gains were free."""
    found = certificate.matrices
    return np.array([found[f"U[{place}]"] @ np.linalg.inv(found[f"X[{place}]"]) for place in places])


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
    targets = [j for j in range(system.modes) if j != mode]
    held = 1.0 + eta * system.delay_max_s
    g2 = np.array([[(certificate.scale * (certificate.gamma or math.inf)) ** 2]])
    return _delayed_block(
        found[f"X[{mode}]"], found[f"U[{mode}]"], g2, found["Q"], *(found[f"X[{j}]"] for j in targets), system=system,
        mode=mode, total=sum(rates[j] for j in targets), pairs=[(rates[j], rates[j]) for j in targets], held=(held, held),
        scale=certificate.scale,
    )  # fmt: skip


def detection_section(
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
        vertices: exact rate vertices instead of the mixed bounds, and everything else as printed.

    Returns:
        A certificate with ``sound = False``, whatever it says.
    """
    check_loop(system, process)
    conditions = {}
    for i, k in itertools.product(range(system.modes), range(process.detection[0].modes)):
        span, r_span = ([*row, math.inf][m : m + 2] for row in (eta_sections[i], r_sections[k]))
        (eta_low, eta_high), (r_low, r_high) = process.failure.bounds(i, *span), process.detection[i].bounds(k, *r_span)
        places = [f"{j},{k}" for j in range(eta_high.size)] + [f"{i},{l}" for l in range(r_high.size)]
        bounds = zip([*eta_low.tolist(), *r_low.tolist()], [*eta_high.tolist(), *r_high.tolist()], places)
        moves = [(low, high, place) for low, high, place in bounds if high > 0]
        corners = [(tuple(high for _, high, _ in moves), sum(low for low, _, _ in moves))]
        if vertices:
            corners = [(rates, sum(rates)) for rates in itertools.product(*({low, high} for low, high, _ in moves))]
        landing = [place for *_, place in moves]
        conditions[f"{i},{k}"] = [
            (partial(inverse_block, system=system, mode=i, leaving=total, rates=list(rates)), landing) for rates, total in corners
        ]
    known = None if gains is None else {place: gains[tuple(map(int, place.split(",")))] for place in conditions}
    build = partial(_program, system, conditions, ("g2",), known, gain_bound)
    what = f"printed (4.{27 if len(eta_sections[0]) > 1 else 26}), section {m + 1}"
    return attenuation_certificate(
        partial(attenuation, build, what, gamma), method="printed",
        assumptions=("the controller measures the fault (false)", "both clocks share one section, sections need no link (false)"),
    )  # fmt: skip


FALSE = "jumps from section m land in section m of the next mode and sections are not linked (false: they land in section 1)"


def printed_stability(
    system: JumpSystem,
    gain: ScheduledGain | None,
    process: SemiMarkov,
    *,
    nodes: Partition | None = None,
    decay: float = 0.0,
) -> JumpCertificate:
    """What the printed conditions say of the loop u = K(i, h) x; a certificate with ``sound = False``, whatever it says.

    Args:
        nodes: sections per mode, by default those of the gains.
        decay: demanded decay rate of E|x|^2 (1/s).

    Raises:
        ValueError: as ``analyse``.
    """
    gain = checked_gain(system, gain, process)
    sections = nodes if nodes is not None else tuple(tuple(row.tolist()) for row in gain.starts_s)
    form = f"printed Corollary 2.1, I <= P <= {CONDITION:g} I"
    found = stability_certificate(system, gain, process, sections, "pwc", decay, CONDITION, form, sound=False)
    return replace(found, method="printed", assumptions=(FALSE, *found.assumptions))


class PrintedRequest(Struct, frozen=True, kw_only=True):
    """Gains by the printed conditions, within a bound of their norm.

    Args:
        gain_bound: largest spectral norm of any gain.
        sections: number of equal-probability sections, or section starts per mode.
    """

    process: SemiMarkov
    gain_bound: float
    sections: int | Partition = 2

    @property
    def starts(self) -> Partition:
        """Section starts per mode."""
        return equal_probability(self.process, self.sections) if isinstance(self.sections, int) else self.sections

    def find(self, system: JumpSystem, decay: float, *, quick: bool = False) -> LmiSolution:
        """Solve (2.21). Raises Infeasible with the proof, or (``quick``: at once) with the best margin reached."""
        program = feedback_program(system, self.process, self.starts, "pwc", self.gain_bound, decay, CONDITION, sound=False)
        found = decide(program, verify_with="nothing" if quick else "cvxpy")
        if not found.holds:
            raise Infeasible(f"printed Corollary 2.2, gain norm <= {self.gain_bound:g}: {found.explain()}", value=found.margin)
        return found

    def judge(self, system: JumpSystem, found: LmiSolution, decay: float) -> JumpCertificate:
        """The gains and what the printed test says of them (``sound = False``); Infeasible where it does not accept them."""
        gain = tabulate(found, self.starts, "pwc", "hold", 1)
        gain = replace(gain, gain=gain.gain * min(1.0, self.gain_bound / gain.norm))
        certificate = printed_stability(system, gain, self.process, nodes=self.starts, decay=decay)
        if not certificate.certified:
            raise Infeasible(f"printed Corollary 2.2: gains found, but {certificate.reason}", value=certificate.margin)
        return certificate
