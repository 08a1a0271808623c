"""The mixed virtual wall: materials, the force of one sample, and what happens where the material changes under the avatar.

    f = K (x_v - delta) + B (x_v(k) - x_v(k-1))/T  in contact, never below 0,     x_v = a - c_0 f

where a is the avatar's place without the newest force, and c_0 the direct part of the coupler. Both equations hold at once;
the answer is unique because the wall's force does not fall with depth.

Reference: Chapter 6, (6.8), (6.11).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

from design.controllers.wall_pattern import Pattern
from design.errors import FieldError

Switching = Literal["plain", "energy"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Material:
    """A spring and a damper.

    Args:
        stiffness_n_per_m: K in N/m, above 0.
        damping_n_s_per_m: B in N s/m, at least 0.

    Raises:
        FieldError: where a number is out of range.
    """

    stiffness_n_per_m: float
    damping_n_s_per_m: float = 0.0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.stiffness_n_per_m) and self.stiffness_n_per_m > 0.0):
            raise FieldError("stiffness_n_per_m", f"{self.stiffness_n_per_m!r}, expected a finite number above 0")
        if not (math.isfinite(self.damping_n_s_per_m) and self.damping_n_s_per_m >= 0.0):
            raise FieldError("damping_n_s_per_m", f"{self.damping_n_s_per_m!r}, expected a finite number, at least 0")

    def energy_j(self, depth_m: float, force_limit_n: float = math.inf) -> float:
        """Return the energy stored at a depth, in J: K s^2/2, beyond the force limit a straight line."""
        s = max(depth_m, 0.0)
        bend = force_limit_n / self.stiffness_n_per_m
        if s <= bend:
            return 0.5 * self.stiffness_n_per_m * s * s
        return force_limit_n * (s - 0.5 * bend)

    def depth_m(self, energy_j: float, force_limit_n: float = math.inf) -> float:
        """Return the depth that stores an energy, in m: the inverse of `energy_j`."""
        bend = force_limit_n / self.stiffness_n_per_m
        if energy_j <= 0.5 * force_limit_n * bend:
            return math.sqrt(2.0 * energy_j / self.stiffness_n_per_m)
        return energy_j / force_limit_n + 0.5 * bend


MATERIALS = (
    Material(stiffness_n_per_m=1000.0, damping_n_s_per_m=2.0),
    Material(stiffness_n_per_m=800.0, damping_n_s_per_m=2.0),
    Material(stiffness_n_per_m=800.0, damping_n_s_per_m=5.0),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Wall:
    """A wall that begins at x = 0 and consists of several materials.

    With ``switching = "plain"`` the force jumps with the stiffness, and a change from soft to hard while pressed gives energy
    away: such a wall is not passive. With ``"energy"`` the new material takes over the stored energy by moving its surface by
    delta = max(0, x_v - s'), where the new material stores at depth s' what the old one held; delta is 0 again off the wall.

    Args:
        materials: at least one; the published three by default.
        switching: ``energy`` or ``plain``.
        force_limit_n: largest force in N, above 0; the stored energy grows only linearly beyond it. None for no limit.
        material: index of the one material that is touched, where neither pattern nor chain says which.
        pattern: which material lies where; the hand's place along the wall picks it.
        chain: nested tuple [i][j], probability of material j after i one sample later, instead of a pattern.
        chain_seed: seed of the chain's path.

    Raises:
        FieldError: where a value is out of range.
    """

    materials: tuple[Material, ...] = MATERIALS
    switching: Switching = "energy"
    force_limit_n: float | None = None
    material: int = 0
    pattern: Pattern | None = None
    chain: tuple[tuple[float, ...], ...] | None = None
    chain_seed: int = 0

    def __post_init__(self) -> None:
        if not self.materials:
            raise FieldError("materials", "none, expected at least one")
        if self.switching not in get_args(Switching):
            raise FieldError("switching", f"{self.switching!r}, expected one of {', '.join(get_args(Switching))}")
        if self.force_limit_n is not None and not self.force_limit_n > 0.0:
            raise FieldError("force_limit_n", f"{self.force_limit_n!r}, expected a number above 0")
        count = len(self.materials)
        if not 0 <= self.material < count:
            raise FieldError("material", f"{self.material}, expected 0 to {count - 1}")
        if self.pattern is not None and self.chain is not None:
            raise FieldError("chain", "give either a pattern or a chain")
        if self.pattern is not None:
            for i, patch in enumerate(self.pattern.patches):
                if patch.material >= count:
                    raise FieldError(f"pattern.patches[{i}].material", f"{patch.material}, expected 0 to {count - 1}")
        for i, row in enumerate(self.chain or ()):
            if len(row) != count or len(self.chain or ()) != count:
                raise FieldError(f"chain[{i}]", f"{len(row)} entries, {len(self.chain or ())} rows, expected {count} of {count}")
            if min(row) < 0.0 or abs(sum(row) - 1.0) > 1e-9:
                raise FieldError(f"chain[{i}]", f"smallest entry {min(row):g}, sum {sum(row):.10g}, expected at least 0 and 1")
        if self.chain_seed < 0:
            raise FieldError("chain_seed", f"{self.chain_seed}, expected at least 0")

    @property
    def limit_n(self) -> float:
        """Largest force in N; inf for none."""
        return math.inf if self.force_limit_n is None else self.force_limit_n

    @property
    def touched(self) -> tuple[Material, ...]:
        """The materials that the avatar can come upon."""
        return (self.materials[self.material],) if self.pattern is None and self.chain is None else self.materials

    @property
    def passive(self) -> bool:
        """Whether the wall is passive for every movement of the avatar and every change of material.

        The energy rule keeps it so; with the plain one only a wall of one stiffness is.
        """
        return self.switching == "energy" or len({m.stiffness_n_per_m for m in self.touched}) == 1


class Contact:
    """The wall in use: the avatar's last place, the material under it, the offset of its surface.

    Args:
        wall: what is touched.
        period_s: T in s.
        material: index of the material at the start.
    """

    __slots__ = ("_limit", "_period_s", "_stiffness_and_rate", "_wall", "avatar_m", "material", "offset_m")

    def __init__(self, wall: Wall, period_s: float, material: int = 0) -> None:
        self._wall, self._period_s, self._limit = wall, period_s, wall.limit_n
        self._stiffness_and_rate = [(m.stiffness_n_per_m, m.damping_n_s_per_m / period_s) for m in wall.materials]
        self.material, self.offset_m, self.avatar_m = material, 0.0, 0.0

    @property
    def energy_j(self) -> float:
        """Energy stored in the wall, in J."""
        if self.avatar_m <= 0.0:
            return 0.0
        wall = self._wall
        return wall.materials[self.material].energy_j(self.avatar_m - self.offset_m, wall.limit_n)

    def change(self, material: int) -> None:
        """Let another material come under the avatar."""
        if material == self.material:
            return
        if self._wall.switching == "energy":
            held, limit = self.energy_j, self._wall.limit_n
            after = self._wall.materials[material].depth_m(held, limit) if held > 0.0 else 0.0
            kept = self.offset_m if held == 0.0 else self.avatar_m - after
            self.offset_m = max(0.0, kept) if self.avatar_m > 0.0 else 0.0
        self.material = material

    def press(self, free_m: float, compliance_m_per_n: float) -> float:
        """Move the avatar for one sample and return the force of the wall on it, in N, at least 0.

        Args:
            free_m: a, the avatar's place without the newest force, in m.
            compliance_m_per_n: c_0 of the coupler in m/N, at least 0.
        """
        force, self.avatar_m = self._solve(free_m, compliance_m_per_n)
        if self.avatar_m <= 0.0:
            self.offset_m = 0.0
        return force

    def _solve(self, a: float, c0: float) -> tuple[float, float]:
        if a < 0.0:
            return 0.0, a
        limit, delta, before = self._limit, self.offset_m, self.avatar_m
        stiffness, rate = self._stiffness_and_rate[self.material]
        pull = -rate * before
        if c0 > 0.0 and c0 * (0.0 if pull < 0.0 else limit if pull > limit else pull) >= a:
            return a / c0, 0.0  # the damper alone stops the avatar at the surface
        x = (a + c0 * rate * before) / (1.0 + c0 * rate)
        if x > delta:
            x = (a + c0 * (stiffness * delta + rate * before)) / (1.0 + c0 * (stiffness + rate))
        depth = x - delta
        force = stiffness * (0.0 if depth < 0.0 else depth) + rate * (x - before)
        if force <= 0.0:
            return 0.0, a
        if force > limit:
            return limit, a - c0 * limit
        return force, x
