"""How stiff a wall can be that is safe for every passive hand: over rate, delay and hand damping.

The shape of the stiffest coupler depends on the delays alone, so that one proof holds for every rate and damping: it is made for
taps that are half the margin smaller, which is far more than rounding the taps of a cell takes away.

Reference: Theorem 6.1; ERRATA 22.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from design.controllers.coupler import Coupler
from design.errors import DesignError
from design.passivity.condition import is_passive_over
from design.passivity.device import HeldDevice
from design.passivity.limits import colgate_n_per_m, exact_n_per_m, gil_hulin_n_per_m
from design.passivity.synthesis import MARGIN, ceiling_n_per_m, stiffest_coupler


@dataclass(frozen=True, slots=True, kw_only=True)
class StiffnessCell:
    """What is possible at one rate, delay and hand damping; stiffnesses in N/m.

    Args:
        period_s: T in s.
        delay: largest total delay nd in samples.
        hand_damping_n_s_per_m: least damping b_h of any hand.
        certified_n_per_m: 1/C(1) of a coupler that is safe for every passive hand and wall at every delay from 0 to nd.
        ceiling_n_per_m: 2 (b + b_h)/((nd + 1) T), the limit for every passive hand.
        colgate_n_per_m: largest K of b + b_h > K T/2 without coupler and delay; None with a delay, of which it knows nothing.
        gil_hulin_n_per_m: (b + b_h)/(T/2 + nd T), the linear boundary of stability without a coupler.
        exact_n_per_m: stiffness at which the wall without a coupler loses stability on the device without a hand.
        taps_m_per_n: the coupler.
    """

    period_s: float
    delay: int
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
                        delay=delay,
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
    for name, given in (("period_s", period_s), ("damping_n_s_per_m", damping_n_s_per_m)):
        if not (np.isfinite(given) and given > 0.0):
            raise DesignError(f"{name}: {given!r}, expected a finite number above 0", value=given)
    unit = period_s / (2.0 * damping_n_s_per_m)
    return Coupler(taps_m_per_n=tuple(unit * s for s in proved_shape(delay)))


@lru_cache(maxsize=128)
def proved_shape(delay: int) -> tuple[float, ...]:
    """Return taps in units of T/(2 b) that are safe at every delay from 0 to nd, with half the margin left for rounding.

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
