"""Which material lies where: a pattern of rectangles that repeats over the plane, or a Markov chain instead of one.

Reference: Chapter 6, Section 6.2.2, Figure 6.2, Remark 6.1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

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

    def material_at(self, y_m: float, z_m: float) -> int:
        """Return the index of the material at a point of the plane."""
        return self.finder()(y_m, z_m)

    def finder(self) -> Callable[[float, float], int]:
        """Return `material_at` with the edges computed once, for a loop."""
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
