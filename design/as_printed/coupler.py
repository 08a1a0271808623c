"""Chapter 6 as it stands, not sound: Lambda, the coupler of Theorem 6.1, the function that (6.10) calls positive real.

Reference: Chapter 6, (6.9), (6.10), (6.11), Section 6.5; what replaces it: `design.passivity`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from design.controllers.coupler import Coupler, wave_coupler
from design.controllers.wall import Contact, Material, Wall
from design.jump_linear.mjls import MJLS
from design.passivity.condition import is_passive_over
from design.passivity.device import HeldDevice
from design.passivity.transparency import distortion

PERIOD_S = 0.05
DELAY = 6
LAMBDA = ((0.4, 0.3, 0.3), (0.3, 0.4, 0.3), (0.15, 0.15, 0.7))


def theorem_61_coupler(damping_n_s_per_m: float, period_s: float = PERIOD_S) -> Coupler:
    """Return C(z) = T/(2 b), which meets (6.9) with equality; (6.9) has no delay in it.

    Args:
        damping_n_s_per_m: b in N s/m.
        period_s: T in s.
    """
    return wave_coupler(period_s, damping_n_s_per_m, 0)


def meets_printed_condition(coupler: Coupler, damping_n_s_per_m: float, period_s: float = PERIOD_S) -> bool:
    """Return whether (6.9) holds, decided exactly; over a delay it says nothing of the loop.

    Args:
        coupler: C.
        damping_n_s_per_m: b in N s/m.
        period_s: T in s.
    """
    return is_passive_over(coupler, period_s, damping_n_s_per_m, 0)


def least_real_part(device: HeldDevice, delay: int, period_s: float = PERIOD_S, points: int = 20_000) -> float:
    """Return the least real part on a grid of ((z-1)/(T z) F(z) + (z-1)/(2 b z)) z^-n, which (6.10) says is positive real.

    F is the zero-order hold of the position, without a hand: the printed 1/s^2 belongs to the velocity.

    Args:
        device: m and b.
        delay: n in samples.
        period_s: T in s.
        points: angles in (0, pi].
    """
    A, B = device.discretise(period_s)
    z = np.exp(1j * np.pi * np.arange(1, points + 1) / points)
    # C (z I - A)^-1 B of a second-order A with A[1, 0] = 0
    held = B[0] / (z - A[0, 0]) + A[0, 1] * B[1] / ((z - A[0, 0]) * (z - A[1, 1]))
    b = device.damping_n_s_per_m
    value: npt.NDArray[np.complex128] = ((z - 1) / (period_s * z) * held + (z - 1) / (2 * b * z)) * z**-delay
    return float(value.real.min())


def printed_distortion(
    materials: Sequence[Material], transition: npt.ArrayLike, coupler: Coupler, *, cutoff_hz: float, delay: int = DELAY
) -> MJLS:
    """Return (6.14) as printed, for a strictly proper weight: nothing drives the weight's state, so that z stays 0.

    The last rows of the printed A and B lack B_w. (6.15) to (6.17) speak of this system, whose norm is 0 (ERRATA 26).

    Args:
        materials: one per mode.
        transition: Lambda.
        coupler: C, without an integrator.
        cutoff_hz: of the weight W, a first-order low-pass, in Hz.
        delay: nd in samples.
    """
    meant = distortion(materials, transition, coupler, period_s=PERIOD_S, delay=delay, cutoff_hz=cutoff_hz)
    A, B = np.array(meant.A, dtype=np.float64), np.array(meant.B, dtype=np.float64)
    A[:, -1, :-1], B[:, -1] = 0.0, 0.0
    return MJLS(A=A, B=B, C=meant.C, transition=transition)


def energy_of_a_press(switching: str, depth_m: float = 0.1) -> float:
    """Return what a wall absorbs in J that is pressed at K = 800 N/m and released at 1000 N/m; (6.11) says at least 0.

    Args:
        switching: ``plain``, as printed, or ``energy``.
        depth_m: depth of the press in m.
    """
    soft, hard = Material(stiffness_n_per_m=800.0), Material(stiffness_n_per_m=1000.0)
    wall = Wall(materials=(soft, hard), switching="plain" if switching == "plain" else "energy")
    contact, total = Contact(wall, PERIOD_S), 0.0
    way = np.linspace(0.0, depth_m, 400).tolist()
    for material, positions in ((0, way), (1, way[::-1])):
        contact.change(material)
        for position in positions:
            before = contact.avatar_m
            total += contact.press(position, 0.0) * (contact.avatar_m - before)
    return total
