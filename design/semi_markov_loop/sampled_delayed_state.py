"""A Lyapunov function for the sampled loop of Chapter 3: a state delay inside the plant, feedback sampled and held.

    dx/dt = A_i x + Ad_i w + B_i v_-D,    w(t) = x(t - tau_i(t)),    d tau_i/dt <= h_i < 1,    v held,    i = mode

With z = (x, v_0, ..., v_-D), phase s in [0, T] of the sample period, label b of the gain that the last sample found, and

    V = z' P_ib(s) z,    P_ib piecewise linear in s,    Q = sum_i S_i / (1 - h_i),

    [ dP_ib/ds + Az_i' P_ib + P_ib Az_i + sum_j lambda_ij (P_j0 - P_ib) + [Q 0; 0 0]     P_ib Adz_i ]
    [ Adz_i' P_ib                                                                           -S_i    ]
        + tau_max [F_i Ad_i]' R [F_i Ad_i] - (1 / tau_max) [E -I]' R [E -I]  <  -m I,    E z = x,    F_i z + Ad_i w = dx/dt,

at both ends of every cell of s and at every corner of the rates' bounds (it is affine in s and in the rates), and

    P_ib(T) >= [xi -> z]' P_ic(0) [xi -> z],    c >= b: the labels that the next sample may find, by m I.

Then E int x'Qx + m (|z|^2 + |w|^2) <= V(0) + E int w'S_i w. In mode i the instant t - tau_i(t) goes at 1 - h_i or faster, so
that E int w'S_i w <= const + E int x'Qx, whenever the mode jumps. A short delay differs little from none, however it changes:
x - w is the integral of dx/dt over at most tau_max, so that int (x - w)'R(x - w) <= const + tau_max^2 int (dx/dt)'R(dx/dt) by
Jensen's inequality (R takes that it is one x in all modes). So E int |z|^2 is finite. A jump inside a period leads to
label 0; where the mode was left and entered again unseen, the next sample may find any label.

Reference: thesis (3.1)-(3.2), (3.7), sampled.
"""

from __future__ import annotations

import itertools
import math
from functools import partial

import numpy as np
import numpy.typing as npt

from design.lmi.program import Array, LmiProgram, LmiSolution, symmetric_blocks, symmetric_part, transpose
from design.semi_markov_loop.period_moments import TooLarge, held_flow, svec_size
from design.semi_markov_loop.sojourn_renewal import SampledLoop
from design.semi_markov_loop.system import DelayedJumpSystem

FloatArray = npt.NDArray[np.float64]
CONDITION = 1e4
"""Largest eigenvalue of P that is searched."""
UNKNOWNS = 300
"""Most unknowns of one search, which takes a few seconds."""
_SHAPES = ((False, 1), (True, 1), (False, 2))


def delayed_decrease(system: DelayedJumpSystem, loop: SampledLoop) -> LmiSolution:
    """Search a Lyapunov function, from the smallest program to the largest; the first that holds is returned.

    Args:
        system: the plant with its delay.
        loop: finite rates, gains that are held, period and delays of the network; its ``system`` has the same A and B.

    Returns:
        the last solution that was tried; its margin is m. See ``delayed_program`` for its matrices.

    Raises:
        TooLarge: even the smallest program has more unknowns than ``UNKNOWNS``.
    """
    found = None
    for by_section, cells in _SHAPES:
        labels = loop.gain.starts_s.shape[1] if by_section else 1
        size = loop.size + loop.system.inputs
        unknowns = system.modes * (labels * (cells + 1) * svec_size(size) + svec_size(system.states)) + svec_size(system.states)
        if unknowns > UNKNOWNS and found is None:
            raise TooLarge(f"{system.modes} modes and {size} states with delayed inputs: {unknowns} unknowns, at most {UNKNOWNS}")
        if unknowns <= UNKNOWNS and not (by_section and loop.gain.starts_s.shape[1] == 1):
            found = delayed_program(system, loop, by_section=by_section, cells=cells).solve()
            if found.holds:
                break
    if found is None:
        raise TooLarge("no program was tried")
    return found


def delayed_program(system: DelayedJumpSystem, loop: SampledLoop, *, by_section: bool, cells: int) -> LmiProgram:
    """The inequalities on P[i,b,g], at the nodes g of the phase, on S[i] / |Ad|^2, and on R in a unit of its own.

    Args:
        by_section: whether P has a label b for every section of the gain, or one for all.
        cells: into how many cells the phase of a period is cut.
    """
    size, modes = loop.size + loop.system.inputs, system.modes
    labels = range(loop.gain.starts_s.shape[1] if by_section else 1)
    program = LmiProgram(reach=CONDITION)
    names = [("R", system.states), *((f"S[{i}]", system.states) for i in range(modes))]
    names += [(f"P[{i},{b},{g}]", size) for i, b, g in itertools.product(range(modes), labels, range(cells + 1))]
    for name, n in names:
        program.symmetric(name, n)
        program.require(f"{name} >= 0", lambda p: -p, name)
        program.require(f"{name} bounded", lambda p: p - CONDITION * np.eye(p.shape[-1]), name, strict=False)
    for i, b in itertools.product(range(modes), labels):
        _require_samples(program, loop, i, b, by_section, cells)
        _require_flow(program, system, loop, i, b, by_section, cells)
    return program


def _require_samples(program: LmiProgram, loop: SampledLoop, mode: int, label: int, by_section: bool, cells: int) -> None:
    keep = np.eye(loop.size, loop.size + loop.system.inputs)  # the oldest input has acted and is dropped
    for section in range(label if by_section else 0, loop.gain.starts_s.shape[1]):
        sampled = loop.sampled_at(loop.gain.gain[mode, section]) @ keep

        def rise(old: Array, new: Array, sampled: FloatArray = sampled) -> Array:
            return np.asarray(sampled.T @ new @ sampled - old)

        after = f"P[{mode},{section if by_section else 0},0]"
        program.require(f"sample in mode {mode}, section {section}", rise, f"P[{mode},{label},{cells}]", after)


def _require_flow(
    program: LmiProgram, system: DelayedJumpSystem, loop: SampledLoop, mode: int, label: int, by_section: bool, cells: int
) -> None:
    starts = loop.gain.starts_s[mode]
    until = float(starts[label + 1]) + 2.0 * loop.period_s if by_section and label + 1 < starts.size else math.inf
    low, high = loop.process.bounds(mode, 0.0, until)
    targets = [j for j in range(system.modes) if j != mode and high[j] > 0]
    weights = [f"S[{i}]" for i in range(system.modes)]
    corners = list(itertools.product(*(sorted({float(low[j]), float(high[j])}) for j in targets)))
    for g, end, corner in itertools.product(range(cells), (0, 1), corners):
        function = partial(_change, system=system, mode=mode, rates=corner, end=end, cell_s=loop.period_s / cells)
        own = [f"P[{mode},{label},{g}]", f"P[{mode},{label},{g + 1}]"]
        landing = [f"P[{j},0,{g + end}]" for j in targets]
        program.require(f"change in mode {mode}, label {label} at rates {corner}", function, *own, "R", *weights, *landing)


def _change(
    first: Array,
    last: Array,
    smooth: Array,
    *rest: Array,
    system: DelayedJumpSystem,
    mode: int,
    rates: tuple[float, ...],
    end: int,
    cell_s: float,
) -> Array:
    n, size = system.states, first.shape[-1]
    here, weights, landing = last if end else first, rest[: system.modes], rest[system.modes :]
    scale = float(np.linalg.norm(system.ad, 2, axis=(1, 2)).max())  # w in units of 1 / |Ad|: the blocks are of one size
    flow, delayed = held_flow(system.a[mode], system.b[mode], size), np.zeros((size, n))
    delayed[:n] = system.ad[mode] / scale
    value = symmetric_part(here @ flow) + (last - first) / cell_s
    for rate, after in zip(rates, landing):
        value = value + rate * (after - here)
    select = np.eye(n, size)
    for slope, weight in zip(system.delay_slopes, weights):
        value = value + scale * scale / (1.0 - slope) * (select.T @ weight @ select)
    whole = symmetric_blocks([[value], [transpose(here @ delayed), -weights[mode]]])
    moves, late = np.hstack([flow[:n], delayed[:n]]), np.hstack([select, -np.eye(n) / scale])
    until, speeds = system.delay_max_s, np.linalg.norm(np.concatenate([system.a, system.ad, system.b], axis=2), 2, axis=(1, 2))
    unit = 1.0 + (until * float(speeds.max())) ** 2  # R in a unit where both terms are of moderate size, at any delay
    return np.asarray(whole + (until * (moves.T @ smooth @ moves) - late.T @ smooth @ late / until) / unit)
