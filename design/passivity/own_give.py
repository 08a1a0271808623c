r"""A coupler per material: what a material gives itself is spared the coupler, C_i(z) = C(z) - s_i.

The condition (*) of `design.passivity.condition` is that of C with any passive wall behind it. A material is no rigid wall:
it has a spring of stiffness K and a damper B, and with g = B/T the port x' = x_v - s f stays passive up to

    s = 1/(K + 2 B/T).

So C with the port x' is C - s with the avatar x_v: the loop is safe by the same condition, and is felt stiffer by s.

Proof. In contact f = p + g v, where p = P'(x_v) is the force of the spring (convex P of slope at most K: unilateral and limited
springs too) and v = x_v(k) - x_v(k-1); where the force is cut off at 0 or at its limit, v is what makes f = p + g v, and
v (x_v(k) - x_v(k-1) - v) >= 0. Take the storage

    S = P(x_v) + g v^2/2 - s f^2/2,        0 <= S, as P >= p^2/(2 K) and (p + g v)^2 <= (K + g) (p^2/K + g v^2).

P(x_v(k-1)) >= P(x_v(k)) - p (x_v(k) - x_v(k-1)) + (dp)^2/(2 K), as P' has slope at most K. Then

    f dx' - dS >= g v^2/2 + g v(k-1)^2/2 + (dp)^2/(2 K) - s (df)^2/2 >= 0,

for df = dp + g v - g v(k-1), and (df)^2 <= (K + g + g) ((dp)^2/K + g v^2 + g v(k-1)^2).

Where the material changes, the wall keeps x' and S by moving its surface (`design.controllers.wall`): what is stored in a spring
that the coupler counts on is handed over too. It is sound for any path over the materials, with or without a law.

Couplers that differ beyond the first tap have no such storage: past forces move the avatar at the change, under pressure, by
what no state of the wall holds. Nor have couplers that jump with the material (``switching = "plain"``).

References: Chapter 6, 6.4, (6.12); Theorem 6.1; ERRATA 22.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from design.controllers.rendered_wall import Coupler
from design.controllers.wall import Material

ROUNDED = 1.0 - 1e-9
"""Kept off the edge, where a wall without a damper would be rigid."""


def sparing(materials: Sequence[Material], coupler: Coupler, period_s: float) -> tuple[Material, ...]:
    """Return the materials with as much spared as each allows, and no more than C(1): none is felt stiffer than it is.

    Args:
        materials: K and B of each.
        coupler: C, which meets the condition for the delays.
        period_s: T in s.
    """
    most = coupler.static_compliance_m_per_n
    return tuple(replace(m, spared_m_per_n=max(min(ROUNDED * m.most_spared_m_per_n(period_s), most), 0.0)) for m in materials)


def felt_n_per_m(material: Material, coupler: Coupler) -> float:
    """Return 1/(1/K + C_i(1)) in N/m: how stiff a material feels under a constant force; 0 behind an integrator.

    Args:
        material: K, and what it spares the coupler.
        coupler: C.
    """
    return 1.0 / (1.0 / material.stiffness_n_per_m + coupler.static_compliance_m_per_n - material.spared_m_per_n)
