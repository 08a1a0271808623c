"""Plants that may change from slot to slot within a set: one quadratic family, x' P_i x by mode, falls over all of them.

    sum_j p_ij A_i(v)' P_j A_i(v) < P_i    for every plant v,  A_i(v) = A_i + [dA_v 0; 0 0] + [dB_v; 0] U_i

The family is sought at some plants (a semidefinite program) and judged at all: the factor by which it grows is convex in the
plant, so it holds between the plants too, and what lies beyond their straight connections is added as a norm.

    growth(v) = max_i |sum_j p_ij A_i(v)' P_j A_i(v)|  in the norm of P_i,   root(v + e) <= root(v) + root of what e adds

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
from design.networked_loop.closed_loop import LoopStructure
from design.networked_loop.joint_modes import check_gains
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
    A, U = structure.matrices(K), structure.applied_input(K)
    chances = structure.transition if structure.between is None else structure.between[1]
    modes, size = A.shape[:2]
    if modes * size * (size + 1) // 2 > MOST_UNKNOWNS:
        return None
    family = np.asarray(cost_once(A, chances, np.broadcast_to(np.eye(size), A.shape)))
    at, best = corners, Growth(np.inf, 0)
    for _ in range(ROUNDS):
        loop = _Coordinates(A, U, family)
        P = _family(loop.moved(at), chances)
        if P is None:
            break
        family = transpose(loop.into) @ P @ loop.into
        own = _Coordinates(A, U, family)
        roots = np.sqrt(_factors(own.moved(changes), chances))
        added = sum(float(np.sqrt(_factors(own.added(each), chances)).max(initial=0.0)) for each in beyond)
        best = min(best, Growth(float((roots.max() + added) ** 2), len(at)), key=lambda each: each.factor)
        if best.factor < 1.0:
            break
        worst = changes[roots.argmax()]
        if not (at == worst).all(axis=(1, 2)).any():
            at = np.concatenate([at, worst[None]])
    return best


class _Coordinates:
    """The loop in coordinates in which a family x' P_i x is the unit matrix, z = into_i x."""

    def __init__(self, A: Array, U: Array, family: Array) -> None:
        self.into = transpose(np.linalg.cholesky(family))
        self._from, self._A, self._U = np.linalg.inv(self.into), A, U

    def moved(self, changes: Array) -> Array:
        """The loops of some plants, into_j A_i(v) from_i of every mode i and next mode j, (v, N, N, size, size)."""
        return self._here(self._A) + self.added(changes)

    def added(self, changes: Array) -> Array:
        """What changes of the plant add to them."""
        n, both = self._A.shape[-1], np.zeros((len(changes), *self._A.shape))
        plant = changes.shape[1]
        both[:, :, :plant, :plant] = changes[:, None, :, :plant]
        both[:, :, :plant] += changes[:, None, :, plant:] @ self._U
        return self._here(both.reshape(len(changes), -1, n, n))

    def _here(self, A: Array) -> Array:
        return np.asarray(self.into @ (A @ self._from)[..., None, :, :])


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
