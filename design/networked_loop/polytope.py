"""Plants that may change from slot to slot within a set: one quadratic family, x' P_i x by mode, falls over all of them.

    sum_j p_ij A_i(v)' P_j A_i(v) < P_i    for every plant v,  A_i(v) = A_i + [dA_v 0; 0 0] + [dB_v; 0] U_i

The family is sought at some plants (a semidefinite program) and judged at all: the factor by which it grows is convex in the
plant, so it holds between the plants too, and what lies beyond their straight connections is added as a norm.

    growth(v) = max_i |sum_j p_ij A_i(v)' P_j A_i(v)|  in the norm of P_i,   root(v + e) <= root(v) + root of what e adds

`family_growth` takes any loops, as of samples that a relative trigger lets be wrong by a share.

Reference: quadratic stability over a polytope; thesis Remark 7.6 has norm-bounded uncertainty.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from design.jump_linear.second_moment import cost_once
from design.lmi.program import Array as AnyArray
from design.lmi.program import LmiProgram, transpose
from design.networked_loop import check_gains
from design.networked_loop.affine_loop import LoopStructure
from design.processes.delay_chain import Array

MOST_UNKNOWNS = 1500
"""Entries of all P_i together, up to which the program is solved within seconds."""
ROUNDS = 6
"""Programs that are solved; each has the plant over which the last family grew most."""


class Growth(NamedTuple):
    """The largest factor by which the family grows in a slot, over all plants, and at how many plants it was sought."""

    factor: float
    vertices: int


def quadratic_growth(
    structure: LoopStructure, gains: npt.ArrayLike, changes: Array, corners: Array, beyond: Sequence[Array] = ()
) -> Growth | None:
    """Return how much the best family that was found grows in a slot; None where the program is too large to be solved.

    Args:
        structure, gains: the nominal loop, mean-square stable.
        changes: [dA dB] of every plant, (k, n, n + m).
        corners: those of them at which a family is sought first, (v, n, n + m).
        beyond: sets of changes, (., n, n + m); the largest of each set may be added to any plant between two of `changes`.
    """
    K = check_gains(gains, structure.gain_shape)
    A, U, n = structure.matrices(K), structure.applied_input(K), structure.plant_order

    def added(changes: Array) -> Array:
        both = np.zeros((len(changes), *A.shape))
        both[:, :, :n, :n] = changes[:, None, :, :n]
        both[:, :, :n] += changes[:, None, :, n:] @ U
        return both

    chances = structure.transition if structure.between is None else structure.between[1]
    return family_growth(A, chances, A + added(changes), A + added(corners), [added(each) for each in beyond])


def family_growth(nominal: Array, transition: Array, loops: Array, corners: Array, beyond: Sequence[Array] = ()) -> Growth | None:
    """Return how much the best family that was found grows in a slot; None where the program is too large to be solved.

    Args:
        nominal: (N, size, size) a mean-square stable loop, from whose own family the search begins.
        transition: (N, N) transition probabilities, or upper bounds of them.
        loops: (k, N, size, size); any of them, or what lies between them, may come in a slot.
        corners: those of them at which a family is sought first.
        beyond: sets, (., N, size, size); the largest of each set may be added.

    Raises:
        LinAlgError: so near the edge that the nominal loop has no family.
    """
    modes, size = nominal.shape[:2]
    if modes * size * (size + 1) // 2 > MOST_UNKNOWNS:
        return None
    family = np.asarray(cost_once(nominal, transition, np.broadcast_to(np.eye(size), nominal.shape)))
    at, best = corners, Growth(np.inf, 0)
    for _ in range(ROUNDS):
        into = transpose(np.linalg.cholesky(family))  # z = into_i x: the family is the unit matrix
        P = _family(_seen_in(into, at), transition)
        if P is None:
            break
        family = transpose(into) @ P @ into
        into = transpose(np.linalg.cholesky(family))
        roots = np.sqrt(_factors(_seen_in(into, loops), transition))
        added = sum(float(np.sqrt(_factors(_seen_in(into, each), transition)).max(initial=0.0)) for each in beyond)
        best = min(best, Growth(float((roots.max() + added) ** 2), len(at)), key=lambda each: each.factor)
        if best.factor < 1.0:
            break
        worst = loops[roots.argmax()]
        if not (at == worst).all(axis=(1, 2, 3)).any():
            at = np.concatenate([at, worst[None]])
    return best


def _seen_in(into: Array, A: Array) -> Array:
    """into_j A_i into_i^-1 of every mode i and next mode j, (v, N, N, size, size)."""
    return np.asarray(into @ (A @ np.linalg.inv(into))[..., None, :, :])


def _family(A: Array, transition: Array) -> Array | None:
    """The P_i <= I whose fall is the largest share of I at all plants, (N, size, size); None where none was found."""
    program, (modes, size) = LmiProgram(), A.shape[2:4]
    for i in range(modes):
        program.symmetric(f"P{i}", size)
    one = np.eye(size)
    for i in range(modes):
        after = np.flatnonzero(transition[i] > 0.0)
        program.require(f"P{i} <= I", lambda P: P - one, f"P{i}", strict=False)
        for v in range(len(A)):
            fall = partial(_fall, A=A[v, i, after], chances=transition[i, after])
            program.require(f"fall in mode {i} at plant {v}", fall, f"P{i}", *(f"P{j}" for j in after))
    found = program.solve()
    P = np.array([found.matrices[f"P{i}"] for i in range(modes)])
    return P if np.isfinite(P).all() and np.linalg.eigvalsh(P)[:, 0].min() > 1e-12 else None


def _fall(own: AnyArray, *after: AnyArray, A: Array, chances: Array) -> AnyArray:
    """Sum_j p_ij A_ij' P_j A_ij - P_i."""
    moved = [chance * transpose(a) @ P @ a for a, chance, P in zip(A, chances, after, strict=True)]
    return np.asarray(sum(moved, start=-own))


def _factors(A: Array, transition: Array) -> Array:
    """The largest factor by which the sum of p_ij |A_ij z|^2 exceeds |z|^2, per plant, (v,)."""
    stacked = (np.sqrt(transition)[:, :, None, None] * A).reshape(*A.shape[:2], -1, A.shape[-1])
    return np.asarray(np.linalg.norm(stacked, 2, axis=(-2, -1)).max(axis=1) ** 2)
