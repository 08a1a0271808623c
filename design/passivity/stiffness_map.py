"""How stiff a wall can be: by a coupler that is safe for every passive hand, over rate, delay and hand damping; and without.

Reference: Theorem 6.1; ERRATA 22; for a wall without a coupler Colgate and Schenkel, Passivity of a class of sampled-data
systems, 1997; Gil, Sanchez, Hulin, Preusche and Hirzinger, Stability boundary for haptic rendering: influence of damping and
delay, 2009.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from msgspec import Struct

from design.controllers.rendered_wall import Coupler
from design.controllers.wall import Material
from design.errors import DesignError
from design.passivity import HapticLoop, HeldDevice
from design.passivity.condition import is_passive_over
from design.passivity.synthesis import MARGIN, ceiling_n_per_m, stiffest_coupler, unit_m_per_n

NO_COUPLER = Coupler(taps_m_per_n=(0.0,))


def colgate_n_per_m(period_s: float, damping_n_s_per_m: float, wall_damping_n_s_per_m: float = 0.0) -> float:
    """Return the largest K of b > K T/2 + |B|, in N/m, for a wall without delay; negative where no K meets it.

    Args:
        period_s: T in s.
        damping_n_s_per_m: b + b_h in N s/m.
        wall_damping_n_s_per_m: B in N s/m.
    """
    return 2.0 * (damping_n_s_per_m - abs(wall_damping_n_s_per_m)) / period_s


def gil_hulin_n_per_m(period_s: float, damping_n_s_per_m: float, delay: int, wall_damping_n_s_per_m: float = 0.0) -> float:
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


class StiffnessCell(Struct, frozen=True, kw_only=True):
    """What is possible at one rate, delay and hand damping; stiffnesses in N/m.

    Args:
        period_s: T in s.
        delay_samples: largest total delay nd.
        hand_damping_n_s_per_m: least damping b_h of any hand.
        certified_n_per_m: 1/C(1) of a coupler that is safe for every passive hand and wall at every delay from 0 to nd.
        ceiling_n_per_m: 2 (b + b_h)/((nd + 1) T), the limit for every passive hand.
        colgate_n_per_m: largest K of b + b_h > K T/2 without coupler and delay; None with a delay, of which it knows nothing.
        gil_hulin_n_per_m: (b + b_h)/(T/2 + nd T), the linear boundary of stability without a coupler.
        exact_n_per_m: stiffness at which the wall without a coupler loses stability on the device without a hand.
        taps_m_per_n: the coupler.
    """

    period_s: float
    delay_samples: int
    hand_damping_n_s_per_m: float
    certified_n_per_m: float
    ceiling_n_per_m: float
    colgate_n_per_m: float | None
    gil_hulin_n_per_m: float
    exact_n_per_m: float
    taps_m_per_n: tuple[float, ...]


def stiffness_map(
    *,
    mass_kg: float,
    damping_n_s_per_m: float,
    periods_s: Sequence[float],
    delays: Sequence[int],
    hands_n_s_per_m: Sequence[float],
) -> tuple[StiffnessCell, ...]:
    """Return every cell of a map, by period, delay and hand.

    Args:
        mass_kg, damping_n_s_per_m: m and b of the device at its tip.
        periods_s: T in s.
        delays: largest delays in samples.
        hands_n_s_per_m: least damping of a hand in N s/m, at least 0.

    Raises:
        DesignError: a value out of range, or device and hand without any damping.
    """
    for name, values in (("delays", delays), ("hands_n_s_per_m", hands_n_s_per_m)):
        if min(values) < 0:
            raise DesignError(f"{name}: {min(values):g}, expected at least 0", value=min(values))
    device = HeldDevice(mass_kg=mass_kg, damping_n_s_per_m=damping_n_s_per_m)
    cells = []
    for period in periods_s:
        for delay in delays:
            alone = exact_n_per_m(device, period, delay)
            for hand in hands_n_s_per_m:
                beta = damping_n_s_per_m + hand
                coupler = certified_coupler(delay, period_s=period, damping_n_s_per_m=beta)
                cells.append(
                    StiffnessCell(
                        period_s=period,
                        delay_samples=delay,
                        hand_damping_n_s_per_m=hand,
                        certified_n_per_m=1.0 / coupler.static_compliance_m_per_n,
                        ceiling_n_per_m=ceiling_n_per_m(period, beta, delay),
                        colgate_n_per_m=None if delay else colgate_n_per_m(period, beta),
                        gil_hulin_n_per_m=gil_hulin_n_per_m(period, beta, delay),
                        exact_n_per_m=alone,
                        taps_m_per_n=coupler.taps_m_per_n,
                    )
                )
    return tuple(cells)


def certified_coupler(delay: int, *, period_s: float, damping_n_s_per_m: float) -> Coupler:
    """Return the coupler for every delay from 0 to nd, from the shape that was proved once.

    Args:
        delay: nd in samples.
        period_s: T in s.
        damping_n_s_per_m: b + b_h in N s/m, above 0.

    Raises:
        DesignError: a value out of range.
    """
    unit = unit_m_per_n(period_s, damping_n_s_per_m)
    return Coupler(taps_m_per_n=tuple(unit * s for s in proved_shape(delay)))


@lru_cache(maxsize=128)
def proved_shape(delay: int) -> tuple[float, ...]:
    """Return taps in units of T/(2 b) that are safe at every delay from 0 to nd, with half the margin left for rounding.

    The shape of the stiffest coupler depends on the delays alone, so that one proof holds for every rate and damping: it is made
    for taps that are half the margin smaller, which is far more than rounding the taps of a cell takes away.

    Args:
        delay: nd in samples.

    Raises:
        DesignError: no proof was found.
    """
    shape = stiffest_coupler(range(delay + 1), period_s=2.0, damping_n_s_per_m=1.0).coupler.taps_m_per_n
    left = 0.5 * MARGIN * sum(shape)
    lost = 8.0 * float(np.finfo(float).eps) * sum(abs(s) * (2 * l + 1) for l, s in enumerate(shape))
    smaller = Coupler(taps_m_per_n=(shape[0] - left, *shape[1:]))
    if lost > left or not all(is_passive_over(smaller, 2.0, 1.0, d) for d in range(delay + 1)):
        raise DesignError(f"delay: {delay}; no coupler was proved with a margin of {left:.3g}", value=left)
    return shape
