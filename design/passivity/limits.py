"""How stiff a wall can be without a coupler: the anchors of the field, and the exact boundary without a hand.

References: Colgate and Schenkel, Passivity of a class of sampled-data systems, 1997; Gil, Sanchez, Hulin, Preusche and Hirzinger,
Stability boundary for haptic rendering: influence of damping and delay, 2009.
"""

from __future__ import annotations

from design.controllers.coupler import Coupler
from design.controllers.wall import Material
from design.passivity.device import HeldDevice
from design.passivity.loop import HapticLoop

NO_COUPLER = Coupler(taps_m_per_n=(0.0,))


def colgate_n_per_m(period_s: float, damping_n_s_per_m: float, wall_damping_n_s_per_m: float = 0.0) -> float:
    """Return the largest K of b > K T/2 + |B|, in N/m, for a wall without delay; negative where no K meets it.

    Args:
        period_s: T in s.
        damping_n_s_per_m: b + b_h in N s/m.
        wall_damping_n_s_per_m: B in N s/m.
    """
    return 2.0 * (damping_n_s_per_m - abs(wall_damping_n_s_per_m)) / period_s


def gil_hulin_n_per_m(
    period_s: float, damping_n_s_per_m: float, delay: int, wall_damping_n_s_per_m: float = 0.0
) -> float:
    """Return K = (b + B)/(T/2 + nd T) in N/m, the linear boundary of stability for a delayed wall (not of passivity).

    It is exact as K and B become small against what mass and period allow.

    Args:
        period_s: T in s.
        damping_n_s_per_m: b + b_h in N s/m.
        delay: nd, samples.
        wall_damping_n_s_per_m: B in N s/m.
    """
    return (damping_n_s_per_m + wall_damping_n_s_per_m) / ((delay + 0.5) * period_s)


def exact_n_per_m(device: HeldDevice, period_s: float, delay: int, wall_damping_n_s_per_m: float = 0.0) -> float:
    """Return the stiffness in N/m at which the wall without a coupler loses stability, by bisection of the spectral radius.

    Args:
        device: device, with the hand that it is held by, if any.
        period_s: T in s.
        delay: nd, samples.
        wall_damping_n_s_per_m: B in N s/m.

    Returns:
        The first such stiffness as it rises from 0, to 1e-9 relative; 0 where the softest wall is not stable.
    """
    loop = HapticLoop(device=device, coupler=NO_COUPLER, period_s=period_s, sc_max=delay, ca_max=0)

    def stable(stiffness: float) -> bool:
        material = Material(stiffness_n_per_m=stiffness, damping_n_s_per_m=wall_damping_n_s_per_m)
        return loop.radius(material, delay, 0) < 1.0

    low = 1e-3 * gil_hulin_n_per_m(period_s, device.total_damping_n_s_per_m, delay, wall_damping_n_s_per_m)
    if not (low > 0.0 and stable(low)):
        return 0.0
    high = low
    while stable(high):
        low, high = high, 1.3 * high
    while high - low > 1e-9 * high:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    return low
