"""Viscous, Coulomb, static and Stribeck friction."""

from __future__ import annotations

from msgspec import Struct

from plants.errors import FieldError, require_not_negative

_CHORDS = 24
_REACH = 3.0  # the Stribeck curve ends at 3 Stribeck speeds, where exp(-9) of it is left


class Friction(Struct, frozen=True, kw_only=True):
    """Friction torque, in volts at the input that balance it.

    F(v) = sign(v) (coulomb + (static - coulomb) exp(-(v/stribeck_speed)^2)) + viscous v,  v != 0;
    at v = 0 the body sticks as long as |drive| <= static.

    The exponential is followed by 24 chords up to 3 Stribeck speeds (largest error 0.4 % of static - coulomb), which
    keeps every piece of the motion exact. Without a Stribeck speed the torque falls to the Coulomb value at once.

    Args:
        coulomb_v: sliding friction in V.
        static_v: break-away friction in V, at least coulomb_v; by default coulomb_v.
        stribeck_speed_rad_s: speed in rad/s over which static goes into Coulomb friction; 0 for at once.
        viscous_v_s_per_rad: friction in V per rad/s, in addition to the viscous part in the pole of the plant.

    Raises:
        ValueError: where a parameter is negative or not finite, or static_v is below coulomb_v.
    """

    coulomb_v: float = 0.0
    static_v: float | None = None
    stribeck_speed_rad_s: float = 0.0
    viscous_v_s_per_rad: float = 0.0

    def __post_init__(self) -> None:
        require_not_negative("coulomb_v", self.coulomb_v)
        require_not_negative("stribeck_speed_rad_s", self.stribeck_speed_rad_s)
        require_not_negative("viscous_v_s_per_rad", self.viscous_v_s_per_rad)
        if self.static_v is not None:
            require_not_negative("static_v", self.static_v)
            if self.static_v < self.coulomb_v:
                raise FieldError("static_v", f"{self.static_v!r}, expected at least coulomb_v ({self.coulomb_v!r})")

    @property
    def breakaway_v(self) -> float:
        """Largest drive in V under which a body at rest stays at rest."""
        return self.coulomb_v if self.static_v is None else self.static_v

    @property
    def dry(self) -> bool:
        """Whether there is any friction that does not vanish with the speed."""
        return self.breakaway_v > 0.0

    def curve(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Return speeds (rad/s, from 0) and dry friction (V) at the corners; constant after the last one."""
        excess, reach = self.breakaway_v - self.coulomb_v, self.stribeck_speed_rad_s * _REACH
        if excess == 0.0 or reach == 0.0:
            return (0.0,), (self.coulomb_v,)
        speeds = tuple(reach * i / _CHORDS for i in range(_CHORDS + 1))
        # exp(-x^2) with x = 3 i/24 = i/8, as a power of exp(-1/64), by products: libm's exp differs between machines
        base, decay, values = 0.9844964370054085, 1.0, [self.breakaway_v]
        for i in range(1, _CHORDS):
            for _ in range(2 * i - 1):
                decay *= base
            values.append(self.coulomb_v + excess * decay)
        return speeds, (*values, self.coulomb_v)
