"""What a descent over the free gains needs: norms of the closed loop with exact derivatives, and first gains that make it stable.

First gains are found by discounting; where there are none, a number says why.
"""

from __future__ import annotations

from functools import partial

import numpy as np
import numpy.typing as npt

from design.errors import NotStable
from design.jump_linear import H2Derivative, H2Nearby, h2_derivative
from design.jump_linear.bounded_real import Fold, locate_norm, many, refine_fold, solve_bounded_real
from design.jump_linear.order_of_modes import strong_classes
from design.jump_linear.second_moment import Resolvent, expect, mean_square_radius
from design.jump_linear.stability_proof import StabilityProof, is_positive
from design.networked_loop.affine_loop import LoopStructure
from design.processes.delay_chain import Array
from design.tracking import GainParametrisation
from design.tracking.bfgs import Descent, bfgs

FLATTEST = 1e-8
"""Least curvature that a descent starts with, as a share of the largest."""


class LoopObjective:
    """H2 and H-infinity norm over a gain space; counts evaluations, and starts each fold from the last one.

    An H-infinity norm above `ceiling` may be said as inf: to know that it is above takes far less than to find it.

    Args:
        structure: the loop.
        space: its free gains.
        alpha: (N,) initial mode distribution.
    """

    def __init__(self, structure: LoopStructure, space: GainParametrisation, alpha: Array) -> None:
        self.structure, self.space, self.alpha = structure, space, alpha
        self.evaluations = 0
        self.ceiling = np.inf
        self._fold: Fold | None = None
        self._zero = np.zeros((structure.B.shape[0], structure.C.shape[1], structure.B.shape[2]))
        self._nearby: H2Nearby | None = None
        self._proof: StabilityProof | None = None
        self._last: H2Derivative | None = None
        if many((structure.base, structure.B, structure.C, self._zero, structure.transition)):
            self._nearby = H2Nearby(structure.B, structure.C, structure.transition, alpha)
            self._proof = StabilityProof(structure.transition)

    def radius(self, v: Array) -> float:
        """Spectral radius of the second-moment operator."""
        return mean_square_radius(self.structure.matrices(self.space.gains(v)), self.structure.transition)

    def h2(self, v: Array, scale: float = 1.0) -> tuple[float, Array]:
        """H2 norm of the loop, of matrices times `scale` (a discount, under which any gains are stable)."""
        s = self.structure
        self.evaluations += 1
        A = scale * s.matrices(self.space.gains(v))
        if self._nearby is None:
            found = h2_derivative(A, s.B, s.C, s.transition, self.alpha)
        else:
            found = self._nearby.derivative(A)
        self._last = found
        if found is None or not found.square > 0.0:
            return np.inf, np.zeros_like(v)
        norm = float(np.sqrt(found.square))
        return norm, self.space.gradient(v, s.gain_gradient(scale * found.gradient_A)) / (2.0 * norm)

    def hinf(self, v: Array) -> tuple[float, Array]:
        """H-infinity norm of the loop; its derivative is exact, the norm being smooth wherever its fold is simple."""
        s = self.structure
        self.evaluations += 1
        A = s.matrices(self.space.gains(v))
        matrices = (A, s.B, s.C, self._zero, s.transition)
        fold = None if self._fold is None else refine_fold(matrices, self._fold)
        if fold is None:
            above = None
            if np.isfinite(self.ceiling):
                policy = solve_bounded_real(matrices, self.ceiling**2)
                if policy is None:
                    return np.inf, np.zeros_like(v)
                above = self.ceiling**2, policy
            elif not self._stable(A):
                return np.inf, np.zeros_like(v)
            found = locate_norm(matrices, above)
            if not isinstance(found, Fold):
                return self._without_fold(v, float(np.sqrt(found)))
            fold = found
        self._fold = fold
        return fold.norm, self.space.gradient(v, s.gain_gradient(fold.gradient_A(s.transition)))

    def descend_h2(self, start: Array) -> Descent:
        """Descent of the H2 norm; over many modes it starts with the curvature of one loop, and takes a tenth of the steps."""
        return bfgs(self.h2, start, metric=None if self._nearby is None else self._h2_metric)

    def _h2_metric(self, v: Array) -> Array:
        last = self._last
        assert last is not None
        return self._metric(v, last.S, last.X, float(np.sqrt(last.square)))

    def _hinf_metric(self, v: Array) -> Array:
        fold = self._fold
        return np.eye(v.size) if fold is None else self._metric(v, fold.policy.P, fold.left, fold.power)

    def _metric(self, v: Array, cost: Array, moments: Array, scale: float) -> Array:
        """Inverse of a norm's second derivative with cost and moments held, of the loop evaluated last.

        That is `gain_curvature` over the scale. Gains that are hardly ever used have hardly any: at least `FLATTEST` of the most.
        """
        s = self.structure
        fixed = s.gain_curvature(expect(s.transition, cost), moments, self.space.block)
        values, vectors = np.linalg.eigh(self.space.curvature(v, fixed))
        return np.asarray(scale * (vectors / np.maximum(values, FLATTEST * values[-1])) @ vectors.T)

    def descend_hinf(self, start: Array, value_tolerance: float = 1e-12) -> Descent:
        """Descent of the H-infinity norm, each step below the last: what is above need not be found."""

        def lower(value: float) -> None:
            self.ceiling = value

        try:
            return bfgs(self.hinf, start, value_tolerance=value_tolerance, ceiling=lower, metric=self._hinf_metric)
        finally:
            self.ceiling = np.inf

    def _stable(self, A: Array) -> bool:
        if self._proof is not None:
            return self._proof.holds(A)
        return is_positive(Resolvent(A, self.structure.transition).cost(np.broadcast_to(np.eye(A.shape[-1]), A.shape)))

    def _without_fold(self, v: Array, norm: float) -> tuple[float, Array]:
        """A norm that is reached without a fold (finite memory) has no null vectors: its slope by differences."""
        s, slope = self.structure, np.zeros_like(v)
        step = 1e-5 * max(1.0, float(np.abs(v).max()))
        for i, direction in enumerate(np.eye(v.size) * step):
            ends = []
            for side in (v + direction, v - direction):
                found = locate_norm((s.matrices(self.space.gains(side)), s.B, s.C, self._zero, s.transition))
                ends.append(found.norm if isinstance(found, Fold) else float(np.sqrt(found)))
            slope[i] = (ends[0] - ends[1]) / (2.0 * step)
        return norm, slope


TARGETS = (0.9, 0.97, 0.99, 0.997, 0.999, 0.9997, 0.9999)
ROUNDS_PER_TARGET = 12


def stabilising(objective: LoopObjective, start: Array) -> Array:
    """Coordinates of mean-square stable gains, from any start.

    Matrices times s have s^2 times the radius. The H2 norm of the discounted loop is lowered, which lowers the radius
    too, and s is raised until it is one.

    Raises:
        NotStable: the radius stays at or above 1; `value` is the smallest that was reached.
    """
    v = start
    radius = objective.radius(v)
    best = radius
    for target in TARGETS:
        for _ in range(ROUNDS_PER_TARGET):
            if radius < 1.0 - 1e-7:
                return v
            scale = float(np.sqrt(target / radius))
            descent = bfgs(
                partial(objective.h2, scale=scale),
                v, iterations=60, gradient_tolerance=1e-4, value_tolerance=1e-3, patience=2,
            )  # fmt: skip
            v, before = descent.x, radius
            radius = objective.radius(v)
            best = min(best, radius)
            if radius > before * (1 - 1e-4):
                break
    if radius < 1.0:
        return v
    raise NotStable(
        f"no gains found from this start that make the loop mean-square stable: smallest radius {best:.6g}, expected < 1",
        value=best,
    )


def check_plant(A: Array, B: Array, C: Array) -> None:
    """Refuse a plant that no controller can stabilise, over any network.

    Raises:
        NotStable: an eigenvalue with modulus >= 1 that the input cannot move or the output does not show; `value` is
            its modulus.
    """
    n = A.shape[0]
    for eigenvalue in np.real_if_close(np.linalg.eigvals(A)):  # numpy 2.5 has complex ones alone
        if abs(eigenvalue) < 1.0 - 1e-12:
            continue
        shifted = A - eigenvalue * np.eye(n)
        scale = max(1.0, float(np.abs(A).max()))
        for pencil, why in (
            (np.hstack([shifted, B]), "the input cannot move"),
            (np.vstack([shifted, C]).T, "the output does not show"),
        ):
            if np.linalg.svd(pencil, compute_uv=False)[n - 1] < 1e-10 * scale:
                raise NotStable(
                    f"plant: {why} the eigenvalue {eigenvalue:.6g}, modulus {abs(eigenvalue):.6g}, expected < 1",
                    value=float(abs(eigenvalue)),
                )


def closed_classes(transition: Array) -> list[npt.NDArray[np.intp]]:
    """Sets of modes that the chain never leaves, each without a smaller one inside."""
    return [own for own in strong_classes(transition) if np.isin(np.flatnonzero(transition[own].any(axis=0)), own).all()]
