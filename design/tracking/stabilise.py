"""First gains that make the loop mean-square stable, found by discounting, or the number that says why there are none."""

from __future__ import annotations

from functools import partial

import numpy as np
import numpy.typing as npt

from design.errors import NotStable
from design.processes.delay_chain import Array
from design.tracking.bfgs import bfgs
from design.tracking.loop_objective import LoopObjective

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
    for eigenvalue in np.linalg.eigvals(A):
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
    N = transition.shape[0]
    reach = (transition > 0) | np.eye(N, dtype=bool)
    for _ in range(int(np.ceil(np.log2(max(N, 2))))):
        reach = (reach.astype(np.int64) @ reach.astype(np.int64)) > 0
    classes = []
    seen = np.zeros(N, dtype=bool)
    for i in range(N):
        if seen[i]:
            continue
        members = np.flatnonzero(reach[i] & reach[:, i])
        seen[members] = True
        if not reach[np.ix_(members, np.setdiff1d(np.arange(N), members))].any():
            classes.append(members)
    return classes
