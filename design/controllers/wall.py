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
from design.errors import FieldError, check_above_zero, check_at_least_zero

Switching = Literal["plain", "energy"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Material:
    """A spring and a damper.

    Args:
        stiffness_n_per_m: K in N/m, above 0.
        damping_n_s_per_m: B in N s/m, at least 0.
        spared_m_per_n: how much less compliant the coupler is over this material, C_i(z) = C(z) - spared, in m/N, at least 0
            and below 1/K.

    Raises:
        FieldError: where a number is out of range.
    """

    stiffness_n_per_m: float
    damping_n_s_per_m: float = 0.0
    spared_m_per_n: float = 0.0

    def __post_init__(self) -> None:
        check_above_zero(stiffness_n_per_m=self.stiffness_n_per_m)
        check_at_least_zero(damping_n_s_per_m=self.damping_n_s_per_m)
        if not 0.0 <= self.spared_m_per_n * self.stiffness_n_per_m < 1.0:
            raise FieldError("spared_m_per_n", f"{self.spared_m_per_n!r}, expected at least 0 and less than 1/K")

    def most_spared_m_per_n(self, period_s: float) -> float:
        """Return 1/(K + 2 B/T) in m/N: the most of its own give that a coupler may count on (`design.passivity.transparency`).

        Args:
            period_s: T in s.
        """
        return 1.0 / (self.stiffness_n_per_m + 2.0 * self.damping_n_s_per_m / period_s)

    def spring_n(self, depth_m: float, force_limit_n: float = math.inf) -> float:
        """Return the force of the spring at a depth, in N."""
        return min(self.stiffness_n_per_m * max(depth_m, 0.0), force_limit_n)

    def energy_j(self, depth_m: float, force_limit_n: float = math.inf) -> float:
        """Return the energy stored at a depth, in J: K s^2/2, beyond the force limit a straight line; less what is spared."""
        s = max(depth_m, 0.0)
        bend = force_limit_n / self.stiffness_n_per_m
        lent = self.spared_m_per_n and 0.5 * self.spared_m_per_n * self.spring_n(s, force_limit_n) ** 2
        if s <= bend:
            return 0.5 * self.stiffness_n_per_m * s * s - lent
        return force_limit_n * (s - 0.5 * bend) - lent

    def depth_m(self, energy_j: float, force_limit_n: float = math.inf) -> float:
        """Return the depth that stores an energy, in m: the inverse of `energy_j`."""
        bend, left = force_limit_n / self.stiffness_n_per_m, 1.0 - self.spared_m_per_n * self.stiffness_n_per_m
        if energy_j <= 0.5 * force_limit_n * bend * left:
            return math.sqrt(2.0 * energy_j / (self.stiffness_n_per_m * left))
        return (energy_j + 0.5 * self.spared_m_per_n * force_limit_n**2) / force_limit_n + 0.5 * bend

    def depth_behind_m(self, port_m: float, force_limit_n: float = math.inf) -> float:
        """Return the depth s with s - spared f(s) = port_m, in m, f the force of the spring.

        Args:
            port_m: where the avatar would be without what is spared, in m.
            force_limit_n: largest force in N.
        """
        s = max(port_m, 0.0) / (1.0 - self.spared_m_per_n * self.stiffness_n_per_m)
        if s * self.stiffness_n_per_m > force_limit_n:
            s = port_m + self.spared_m_per_n * force_limit_n
        return s if port_m > 0.0 else port_m


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
    Where materials spare the coupler something (C_i(z) = C(z) - spared_i), it is the place x_v - spared_i f that stays.

    Args:
        materials: at least one; the published three by default.
        switching: ``energy`` or ``plain``.
        force_limit_n: largest force in N, above 0; the stored energy grows only linearly beyond it. By default no limit.
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
    def met(self) -> tuple[int, ...]:
        """Indices of the materials that the avatar can come upon, in their order."""
        if self.pattern is not None:
            return tuple(sorted({patch.material for patch in self.pattern.patches}))
        found, ahead = {self.material}, [self.material]
        while self.chain is not None and ahead:
            more = {j for j, chance in enumerate(self.chain[ahead.pop()]) if chance > 0.0} - found
            found |= more
            ahead += more
        return tuple(sorted(found))

    @property
    def touched(self) -> tuple[Material, ...]:
        """The materials that the avatar can come upon."""
        return tuple(self.materials[i] for i in self.met)

    @property
    def alike(self) -> bool:
        """Whether a change of material moves no surface by the energy rule: what is touched stores alike."""
        kinds = {(m.stiffness_n_per_m, (m.damping_n_s_per_m, m.spared_m_per_n) if self.spares else ()) for m in self.touched}
        return len(kinds) == 1

    @property
    def passive(self) -> bool:
        """Whether changes of material leave the wall passive, for every movement of the avatar.

        The energy rule keeps it so; with the plain one only a wall of one stiffness is, or of one material.
        """
        return self.switching == "energy" or self.alike

    @property
    def spares(self) -> bool:
        """Whether the coupler differs from C over some material."""
        return any(m.spared_m_per_n for m in self.touched)


class Contact:
    """The wall in use: the avatar's last place, the material under it, the offset of its surface.

    Args:
        wall: what is touched.
        period_s: T in s.
        material: index of the material at the start.
    """

    __slots__ = ("_limit", "_period_s", "_stiffness_and_rate", "_wall", "avatar_m", "force_n", "material", "offset_m")

    def __init__(self, wall: Wall, period_s: float, material: int = 0) -> None:
        self._wall, self._period_s, self._limit = wall, period_s, wall.limit_n
        self._stiffness_and_rate = [(m.stiffness_n_per_m, m.damping_n_s_per_m / period_s) for m in wall.materials]
        self.material, self.offset_m, self.avatar_m, self.force_n = material, 0.0, 0.0, 0.0

    @property
    def port_m(self) -> float:
        """Where the wall meets the coupler C that is one for all materials: x_v - spared_i f, in m."""
        return self.avatar_m - self._wall.materials[self.material].spared_m_per_n * self.force_n

    @property
    def energy_j(self) -> float:
        """Energy stored in the wall at `port_m`, in J: of the spring, and of what is spared (`design.passivity.transparency`)."""
        if self.avatar_m <= 0.0:
            return 0.0
        wall, depth = self._wall, self.avatar_m - self.offset_m
        touched = wall.materials[self.material]
        stored = touched.energy_j(depth, wall.limit_n)
        if touched.spared_m_per_n:
            spring, rate = touched.spring_n(depth, wall.limit_n), self._stiffness_and_rate[self.material][1]
            stored += 0.5 * touched.spared_m_per_n * (spring * spring - self.force_n * self.force_n)
            stored += 0.5 * (self.force_n - spring) ** 2 / rate if rate else 0.0
        return stored

    def change(self, material: int) -> None:
        """Let another material come under the avatar."""
        if material == self.material:
            return
        if self._wall.switching == "energy":
            self._hand_over(self._wall.materials[material])
        self.material = material

    def _hand_over(self, to: Material) -> None:
        """Keep the energy, and the place where the wall meets the coupler."""
        held, limit, port = self.energy_j, self._limit, self.port_m
        if held > 0.0 and port > 0.0:
            depth = to.depth_m(held, limit)
            avatar = port + to.spared_m_per_n * to.spring_n(depth, limit)
            self.offset_m = avatar - depth
            if self.offset_m < 0.0:  # it stores less than it might
                depth = avatar = to.depth_behind_m(port, limit)
                self.offset_m = 0.0
            self.avatar_m = avatar
        else:
            self.offset_m, self.avatar_m, depth = self.offset_m if port > 0.0 else 0.0, port, 0.0
        self.force_n = to.spring_n(depth, limit)

    def press(self, free_m: float, compliance_m_per_n: float) -> float:
        """Move the avatar for one sample and return the force of the wall on it, in N, at least 0.

        Args:
            free_m: a, the avatar's place without the newest force, in m.
            compliance_m_per_n: c_0 of the coupler in m/N; less what the material spares, above -1/(K + B/T).
        """
        force, self.avatar_m = self._solve(free_m, compliance_m_per_n - self._wall.materials[self.material].spared_m_per_n)
        self.force_n = force
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
