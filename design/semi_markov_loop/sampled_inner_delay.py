"""Lyapunov functions over the phase of a sample period: of sampled loops whose plant jumps and has a state delay inside.

The loop of Chapter 3 with feedback sampled and held:

    dx/dt = A_i x + Ad_i w + B_i v_-D,    w(t) = x(t - tau_i(t)),    d tau_i/dt <= h_i < 1,    v held,    i = mode

With z, s, Az_i and xi as in `design.semi_markov_loop.sampled_phase` and a label b of the gain that the last sample found,

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

References: thesis (3.1)-(3.2), (3.7), sampled.
"""

from __future__ import annotations

import itertools
import math
from functools import partial

import numpy as np

from design.lmi.program import Array, LmiProgram, LmiSolution, symmetric_blocks, symmetric_part, transpose
from design.semi_markov_loop import DelayedJumpSystem, FloatArray
from design.semi_markov_loop.period_moments import held_flow, svec_size
from design.semi_markov_loop.sampled_phase import CONDITION, add_bounded, corners_of, first_that_holds
from design.semi_markov_loop.sojourn_renewal import SampledLoop

UNKNOWNS = 300
"""Most unknowns of one search, which takes a few seconds."""
SHAPES = ((False, 1), (True, 1), (False, 2))
"""Whether P has a label for every section of the gain, and into how many cells a period is cut."""


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
    size, sections = loop.size + loop.system.inputs, loop.gain.starts_s.shape[1]
    tried = []
    for by_section, cells in SHAPES:
        if not by_section or sections > 1:
            each = (sections if by_section else 1) * (cells + 1) * svec_size(size) + svec_size(system.states)
            program = partial(delayed_program, system, loop, by_section=by_section, cells=cells)
            tried.append((system.modes * each + svec_size(system.states), program))
    return first_that_holds(tried, UNKNOWNS, loop)


def delayed_program(system: DelayedJumpSystem, loop: SampledLoop, *, by_section: bool, cells: int) -> LmiProgram:
    """The inequalities on P[i,b,g], at the nodes g of the phase, on S[i] / |Ad|^2, and on R in a unit of its own.

    Args:
        by_section: whether P has a label b for every section of the gain, or one for all.
        cells: into how many cells the phase of a period is cut.
    """
    size, modes = loop.size + loop.system.inputs, system.modes
    labels = range(loop.gain.starts_s.shape[1] if by_section else 1)
    program = LmiProgram(reach=CONDITION)
    weights = [f"S[{i}]" for i in range(modes)]
    names = [(name, system.states) for name in ("R", *weights)]
    names += [(f"P[{i},{b},{g}]", size) for i, b, g in itertools.product(range(modes), labels, range(cells + 1))]
    for name, n in names:
        add_bounded(program, name, n)
    keep = np.eye(loop.size, size)  # the oldest input has acted and is dropped
    for i, b in itertools.product(range(modes), labels):
        starts = loop.gain.starts_s[i]
        for section in range(b if by_section else 0, starts.size):
            sampled = loop.sampled_at(loop.gain.gain[i, section]) @ keep

            def rise(old: Array, new: Array, sampled: FloatArray = sampled) -> Array:
                return np.asarray(sampled.T @ new @ sampled - old)

            after = f"P[{i},{section if by_section else 0},0]"
            program.require(f"sample in mode {i}, section {section}", rise, f"P[{i},{b},{cells}]", after)
        until = float(starts[b + 1]) + 2.0 * loop.period_s if by_section and b + 1 < starts.size else math.inf
        low, high = loop.process.bounds(i, 0.0, until)
        targets = [j for j in range(modes) if j != i and high[j] > 0]
        for g, end, corner in itertools.product(range(cells), (0, 1), corners_of(targets, low, high)):
            function = partial(_change, system=system, mode=i, rates=corner, end=end, cell_s=loop.period_s / cells)
            own = [f"P[{i},{b},{g}]", f"P[{i},{b},{g + 1}]"]
            landing = [f"P[{j},0,{g + end}]" for j in targets]
            program.require(f"change in mode {i}, label {b} at rates {corner}", function, *own, "R", *weights, *landing)
    return program


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
