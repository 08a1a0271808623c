"""Which material lies where: a pattern of rectangles that repeats over the plane, or a Markov chain instead of one.

How often the material changes under a hand that slides at constant speed is the published Lambda from geometry:

    lambda_ij = nu T c_ij/(pi A_i)

c_ij is the length of the boundary between materials i and j, A_i the area of i, both in one cell; nu the speed. It is the rate
at which a point that moves in a uniformly random direction crosses the boundary (Cauchy and Crofton), to first order in T.

DEVIATION: (6.3) prints a proportion without areas: it gives neither the factor nor the unequal rows of Lambda.

References: Chapter 6, Section 6.2.2, (6.3), Figure 6.2, Remark 6.1; Santalo, Integral Geometry and Geometric Probability, 1976.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import numpy.typing as npt

from design.errors import FieldError, check_above_zero, check_finite


@dataclass(frozen=True, slots=True, kw_only=True)
class Patch:
    """A rectangle of one material.

    Args:
        y_m, z_m: lower left corner in m.
        width_m, height_m: extent along y and z in m, above 0.
        material: index, from 0.

    Raises:
        FieldError: where a value is out of range.
    """

    y_m: float
    z_m: float
    width_m: float
    height_m: float
    material: int

    def __post_init__(self) -> None:
        check_finite(y_m=self.y_m, z_m=self.z_m)
        check_above_zero(width_m=self.width_m, height_m=self.height_m)
        if self.material < 0:
            raise FieldError("material", f"{self.material!r}, expected an index, at least 0")


@dataclass(frozen=True, slots=True, kw_only=True)
class Pattern:
    """A cell of patches that repeats along y and z without end.

    The patches have to cover the cell exactly: no gap, no overlap, nothing beyond its edges.

    Args:
        width_m, height_m: extent of the cell in m.
        patches: what it consists of.

    Raises:
        ValueError: an extent is not above 0, a patch leaves the cell, two overlap, or a gap remains; the message names the
            area that decides.
    """

    width_m: float
    height_m: float
    patches: tuple[Patch, ...]

    def __post_init__(self) -> None:
        check_above_zero(width_m=self.width_m, height_m=self.height_m)
        slack = 1e-9 * max(self.width_m, self.height_m)
        for i, p in enumerate(self.patches):
            out = max(-p.y_m, -p.z_m, p.y_m + p.width_m - self.width_m, p.z_m + p.height_m - self.height_m)
            if out > slack:
                raise FieldError(f"patches[{i}]", f"lies {out:.6g} m outside the cell")
            for j, q in enumerate(self.patches[:i]):
                over_y = min(p.y_m + p.width_m, q.y_m + q.width_m) - max(p.y_m, q.y_m)
                over_z = min(p.z_m + p.height_m, q.z_m + q.height_m) - max(p.z_m, q.z_m)
                if over_y > slack and over_z > slack:
                    raise FieldError(f"patches[{i}]", f"overlaps patches[{j}] on {over_y * over_z:.6g} m^2")
        gap = self.width_m * self.height_m - sum(p.width_m * p.height_m for p in self.patches)
        if gap > slack * (self.width_m + self.height_m):
            raise FieldError("patches", f"leave a gap of {gap:.6g} m^2 of {self.width_m * self.height_m:.6g} m^2")

    def finder(self) -> Callable[[float, float], int]:
        """Return what gives the index of the material at a point (y, z) of the plane, in m, with the edges computed once."""
        width, height, patches = self.width_m, self.height_m, self.patches
        edges = tuple((p.y_m, p.y_m + p.width_m, p.z_m, p.z_m + p.height_m, p.material) for p in patches)

        def find(y_m: float, z_m: float) -> int:
            y, z = y_m % width, z_m % height
            for left, right, bottom, top, material in edges:
                if left <= y < right and bottom <= z < top:
                    return material
            # between two edges that differ by rounding: the nearest patch
            return min(patches, key=lambda p: max(p.y_m - y, y - p.y_m - p.width_m, p.z_m - z, z - p.z_m - p.height_m)).material

        return find


def square_rows(side_m: float) -> Pattern:
    """Return rows of alternating squares of materials 0 and 1 between strips of material 2 that are as high as a square.

    With c_01 = c_02 = c_12 = 2 w and areas w^2, w^2, 2 w^2 it is the pattern that gives the published Lambda exactly
    at nu T = 0.15 pi w.

    Args:
        side_m: w in m.
    """
    w = side_m
    return Pattern(
        width_m=2 * w,
        height_m=2 * w,
        patches=(
            Patch(y_m=0.0, z_m=0.0, width_m=w, height_m=w, material=0),
            Patch(y_m=w, z_m=0.0, width_m=w, height_m=w, material=1),
            Patch(y_m=0.0, z_m=w, width_m=2 * w, height_m=w, material=2),
        ),
    )


Array = npt.NDArray[np.float64]


def boundaries(pattern: Pattern, materials: int) -> tuple[Array, Array]:
    """Return c (N, N), the boundary lengths in m in one cell, zero on the diagonal, and A (N,), the areas in m^2.

    Args:
        pattern: the cell.
        materials: N.

    Raises:
        ValueError: the pattern has a material that the wall has not, or not all of the wall's.
    """
    areas, lengths = np.zeros(materials), np.zeros((materials, materials))
    for i, p in enumerate(pattern.patches):
        if p.material >= materials:
            raise FieldError(f"patches[{i}].material", f"{p.material}, but the wall has {materials} materials (from 0)")
        areas[p.material] += p.width_m * p.height_m
    if not areas.all():
        raise FieldError("patches", f"material {int(np.flatnonzero(areas == 0.0)[0])} has no area in the cell")
    slack = 1e-9 * max(pattern.width_m, pattern.height_m)
    cell = (pattern.width_m, pattern.height_m)
    placed = [(p.material, ((p.y_m, p.width_m), (p.z_m, p.height_m))) for p in pattern.patches]
    for (i, own), (j, other) in product(placed, repeat=2):
        for axis in (0, 1):  # a right edge on a left one, or an upper on a lower one, here or in the next cell
            gap = own[axis][0] + own[axis][1] - other[axis][0]
            if min(abs(gap), abs(gap - cell[axis])) <= slack:
                shared = _overlap(*own[1 - axis], *other[1 - axis])
                lengths[i, j] += shared
                lengths[j, i] += shared
    np.fill_diagonal(lengths, 0.0)
    return lengths, areas


def _overlap(a: float, a_size: float, b: float, b_size: float) -> float:
    return max(0.0, min(a + a_size, b + b_size) - max(a, b))


def material_chain(pattern: Pattern, materials: int, step_m: float) -> Array:
    """Return Lambda (N, N) of a hand that slides nu T in a sample.

    Args:
        pattern: the cell.
        materials: N.
        step_m: nu T in m, at least 0.

    Raises:
        ValueError: see `boundaries`; or the step is so long that a row would leave [0, 1].
    """
    lengths, areas = boundaries(pattern, materials)
    rates = step_m * lengths / (np.pi * areas[:, None])
    leaving = rates.sum(axis=1)
    if not (np.isfinite(leaving).all() and step_m >= 0.0 and leaving.max() <= 1.0):
        raise FieldError(
            "step_m", f"{step_m!r} m in a sample leaves a material with probability {leaving.max():.6g}, expected 0 to 1"
        )
    return np.asarray(rates + np.diag(1.0 - leaving))


def paced_chain(
    pattern: Pattern, materials: int, steps_m: Sequence[float], stays: Sequence[Sequence[float]]
) -> tuple[Array, list[int]]:
    r"""Return the chain of (speed, how long it has lasted, material) of a hand whose speed is a semi-Markov process.

    In a sample at speed s the material follows Lambda(nu_s T). A stay ends after n samples with the hazard of its law; every
    other speed is as likely to follow.

    Args:
        pattern: the cell.
        materials: N.
        steps_m: nu_s T of each of S speeds, in m; two or more.
        stays: per speed the probabilities of a stay of 1, 2, ... samples, each summing to 1.

    Returns:
        The row-stochastic matrix (M, M), and the material of each of the M modes.

    Raises:
        ValueError: as of `material_chain`; or the stays are no probability laws.

    Reference: Chapter 6, 6.6.
    """
    for i, law in enumerate(stays):
        if not len(law) or min(law) < 0.0 or abs(sum(law) - 1.0) > 1e-9 or not law[-1] > 0.0:
            raise FieldError(f"stays[{i}]", f"{list(law)}, expected probabilities that sum to 1, the last one above 0")
    if len(steps_m) != len(stays) or len(stays) < 2:
        raise FieldError("stays", f"{len(stays)} laws and {len(steps_m)} speeds, expected as many of each, at least 2")
    first = np.cumsum([0, *map(len, stays)])
    speed = np.zeros((first[-1], first[-1]))
    step = []
    for s, law in enumerate(stays):
        for n, chance in enumerate(law):
            left, mode = sum(law[n:]), int(first[s]) + n
            ends = chance / left if left > 0.0 and n + 1 < len(law) else 1.0
            if ends < 1.0:
                speed[mode, mode + 1] = 1.0 - ends
            for other in range(len(stays)):
                if other != s:
                    speed[mode, first[other]] = ends / (len(stays) - 1)
            step.append(s)
    law_at = [material_chain(pattern, materials, nu) for nu in steps_m]
    whole = np.block([[speed[i, j] * law_at[step[i]] for j in range(len(step))] for i in range(len(step))])
    return whole, [m for _ in step for m in range(materials)]


DIRECTIONS, POINTS = 64, 200
"""Midpoints over the circle, and over each side of the cell."""


def true_chain(pattern: Pattern, materials: int, step_m: float) -> Array:
    """Return the exact one-step matrix of a uniformly placed point that moves step_m in a uniformly random direction.

    By the midpoint rule over directions and places: it shows how far the linear law of `material_chain` holds.

    Args:
        pattern: the cell.
        materials: N.
        step_m: nu T in m.
    """
    y = (np.arange(POINTS) + 0.5) * pattern.width_m / POINTS
    z = (np.arange(POINTS) + 0.5) * pattern.height_m / POINTS
    here = _materials_at(pattern, *np.meshgrid(y, z))
    joint = np.zeros((materials, materials))
    for angle in (np.arange(DIRECTIONS) + 0.5) * (2.0 * np.pi / DIRECTIONS):
        there = _materials_at(pattern, *np.meshgrid(y + step_m * np.cos(angle), z + step_m * np.sin(angle)))
        np.add.at(joint, (here, there), 1.0)
    return np.asarray(joint / joint.sum(axis=1, keepdims=True))


def _materials_at(pattern: Pattern, y: Array, z: Array) -> npt.NDArray[np.intp]:
    y, z = y % pattern.width_m, z % pattern.height_m
    out = np.zeros(y.shape, dtype=np.intp)
    for p in pattern.patches:
        inside = (p.y_m <= y) & (y < p.y_m + p.width_m) & (p.z_m <= z) & (z < p.z_m + p.height_m)
        out[inside] = p.material
    return out


def memory_statistic(modes: npt.ArrayLike, materials: int) -> tuple[float, int]:
    """Return G and its degrees of freedom for the hypothesis that a path of materials is a first-order Markov chain.

    G = 2 sum n_hij log(n_hij n_i / (n_hi n_ij)) over triples; chi-square with N (N - 1)^2 degrees under the hypothesis.

    Args:
        modes: the material in every sample.
        materials: N.

    Reference: Anderson and Goodman, Statistical inference about Markov chains, 1957.
    """
    path = np.asarray(modes, dtype=np.intp)
    counts = np.zeros((materials,) * 3)
    np.add.at(counts, (path[:-2], path[1:-1], path[2:]), 1.0)
    before, after, middle = counts.sum(axis=2), counts.sum(axis=0), counts.sum(axis=(0, 2))
    expected = before[:, :, None] * after[None, :, :] / np.where(middle == 0.0, 1.0, middle)[None, :, None]
    seen = counts > 0.0
    return 2.0 * float(np.sum(counts[seen] * np.log(counts[seen] / expected[seen]))), materials * (materials - 1) ** 2
