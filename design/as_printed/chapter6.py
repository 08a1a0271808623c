"""Chapter 6 as printed, not sound: the coupler of Theorem 6.1, and the conditions (6.9), (6.10) and (6.17).

- (6.9): the coupler's condition, which has no delay in it.
- (6.17): the attenuation of (6.14), in which nothing drives the weight; it does not know how long the delay is.

Nothing follows from what is met here; what replaces it is `design.passivity`.

Reference: Chapter 6, (6.9)-(6.11), (6.14)-(6.17), Section 6.5; ERRATA 22, 26.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
import numpy.typing as npt

from design.controllers.rendered_wall import Coupler, wave_coupler
from design.controllers.wall import Contact, Material, Wall
from design.errors import FieldError
from design.jump_linear.mjls import MJLS
from design.lmi.decision import decide
from design.lmi.program import LmiProgram, symmetric_blocks
from design.passivity.condition import is_passive_over
from design.passivity.loop import HeldDevice
from design.passivity.transparency import distortion, low_pass

Array = npt.NDArray[np.float64]
PERIOD_S = 0.05
DELAY = 6
LAMBDA = ((0.4, 0.3, 0.3), (0.3, 0.4, 0.3), (0.15, 0.15, 0.7))


def theorem_61_coupler(damping_n_s_per_m: float) -> Coupler:
    """Return C(z) = T/(2 b), which meets (6.9) with equality; (6.9) has no delay in it.

    Args:
        damping_n_s_per_m: b in N s/m.
    """
    return wave_coupler(PERIOD_S, damping_n_s_per_m, 0)


def meets_printed_condition(coupler: Coupler, damping_n_s_per_m: float) -> bool:
    """Return whether (6.9) holds, decided exactly; over a delay it says nothing of the loop.

    Args:
        coupler: C.
        damping_n_s_per_m: b in N s/m.
    """
    return is_passive_over(coupler, PERIOD_S, damping_n_s_per_m, 0)


def least_real_part(device: HeldDevice, delay: int) -> float:
    """Return the least real part on a grid of ((z-1)/(T z) F(z) + (z-1)/(2 b z)) z^-n, which (6.10) says is positive real.

    F is the zero-order hold of the position, without a hand: the printed 1/s^2 belongs to the velocity.

    Args:
        device: m and b.
        delay: n in samples.
    """
    A, B = device.discretise(PERIOD_S)
    z = np.exp(1j * np.pi * np.arange(1, 20_001) / 20_000)  # angles in (0, pi]
    # C (z I - A)^-1 B of a second-order A with A[1, 0] = 0
    held = B[0] / (z - A[0, 0]) + A[0, 1] * B[1] / ((z - A[0, 0]) * (z - A[1, 1]))
    b = device.damping_n_s_per_m
    value: npt.NDArray[np.complex128] = ((z - 1) / (PERIOD_S * z) * held + (z - 1) / (2 * b * z)) * z**-delay
    return float(value.real.min())


def printed_distortion(materials: Sequence[Material], transition: npt.ArrayLike, coupler: Coupler, *, cutoff_hz: float) -> MJLS:
    """Return (6.14) as printed, for a strictly proper weight: nothing drives the weight's state, so that z stays 0.

    The last rows of the printed A and B lack B_w. (6.15) to (6.17) speak of this system, whose norm is 0 (ERRATA 26).

    Args:
        materials: one per mode.
        transition: Lambda.
        coupler: C, without an integrator.
        cutoff_hz: of the weight W, a first-order low-pass, in Hz.
    """
    meant = distortion(materials, transition, coupler, period_s=PERIOD_S, delay=DELAY, cutoff_hz=cutoff_hz)
    A, B = np.array(meant.A, dtype=np.float64), np.array(meant.B, dtype=np.float64)
    A[:, -1, :-1], B[:, -1] = 0.0, 0.0
    return MJLS(A=A, B=B, C=meant.C, transition=transition)


def energy_of_a_press(switching: str) -> float:
    """Return what a wall absorbs in J that is pressed 0.1 m at K = 800 N/m and released at 1000 N/m; (6.11) says at least 0.

    Args:
        switching: ``plain``, as printed, or ``energy``.
    """
    soft, hard = Material(stiffness_n_per_m=800.0), Material(stiffness_n_per_m=1000.0)
    wall = Wall(materials=(soft, hard), switching="plain" if switching == "plain" else "energy")
    contact, total = Contact(wall, PERIOD_S), 0.0
    way = np.linspace(0.0, 0.1, 400).tolist()
    for material, positions in ((0, way), (1, way[::-1])):
        contact.change(material)
        for position in positions:
            before = contact.avatar_m
            total += contact.press(position, 0.0) * (contact.avatar_m - before)
    return total


def meets_printed_attenuation(
    materials: Sequence[Material], transition: npt.ArrayLike, coupler: Coupler, *, cutoff_hz: float, gamma: float
) -> bool:
    """Return whether (6.17) certifies a level for (6.14) as printed, D_w = 0; the delay does not enter.

    In units of gamma: z is divided by gamma, so that gamma^2 I becomes I. Block (2, 3) is read as C_d' E.

    Args:
        materials: one per mode.
        transition: Lambda.
        coupler: C, at least one tap; the first is D_c, the others are the strictly proper part.
        cutoff_hz: of the weight W, in Hz.
        gamma: level in N/m, above 0.

    Raises:
        FieldError: a level that is not positive, or an integrator in the coupler.
    """
    if not gamma > 0.0:
        raise FieldError("gamma", f"{gamma!r}, expected a level above 0")
    modes = [inner_loop(m, coupler, cutoff_hz) for m in materials]
    chain, n = np.asarray(transition, dtype=np.float64), modes[0][0].shape[0]
    program = LmiProgram()
    program.symmetric("Q", n)
    program.require("Q > 0", lambda q: -q, "Q")
    names = [f"P[{i}]" for i in range(len(modes))]
    for i, name in enumerate(names):
        program.symmetric(name, n)
        program.require(f"{name} > 0", lambda p: -p, name)
        program.require(f"(6.17) {i}", partial(_left_side, mode=i, data=modes[i], row=chain[i], gamma=gamma), "Q", *names)
    return decide(program, verify_with="nothing").holds


def _left_side(q: Array, *p: Array, mode: int, data: tuple[Array, Array, Array], row: Array, gamma: float) -> Array:
    A, B, C = data
    after = sum(weight * own for weight, own in zip(row, p))
    C = C / gamma
    xi = A.T @ after @ A - p[mode] + q + C.T @ C
    n = A.shape[0]  # C_d and E are 0 with D_w = 0
    return symmetric_blocks([[xi], [np.zeros((n, n)), -q], [B.T @ after @ A, np.zeros((1, n)), B.T @ after @ B - np.eye(1)]])


def inner_loop(material: Material, coupler: Coupler, cutoff_hz: float) -> tuple[Array, Array, Array]:
    """Return A~ (n, n), B~ (n, 1), C~ (1, n) of (6.14) for D_w = 0; B_w is missing from the last rows, as printed.

    State: (x_g, x_gbar, x_c, x_w).

    Args:
        material: the mode.
        coupler: C, without an integrator; its first tap is D_c.
        cutoff_hz: of the weight W, in Hz.
    """
    if coupler.integrator_m_per_n:
        raise FieldError("coupler", "has an integrator, expected a finite impulse response")
    direct, taps = coupler.taps_m_per_n[0], np.asarray(coupler.taps_m_per_n[1:])
    pole, gain = low_pass(cutoff_hz, PERIOD_S)
    rate = material.damping_n_s_per_m / PERIOD_S
    stiff = material.stiffness_n_per_m + rate
    loop = 1.0 + stiff * direct
    inner = {"A": rate * direct / loop, "B": 1.0 / loop, "C": -rate / loop, "D": stiff / loop}  # of G/(1 + G D_c)
    c, n = taps.size, 3 + taps.size
    A, B, C = np.zeros((n, n)), np.zeros((n, 1)), np.zeros((1, n))
    B[0, 0], B[1, 0] = 1.0, inner["B"]
    A[1, 1] = inner["A"]
    A[1, 2 : 2 + c] = -inner["B"] * taps
    if c:
        A[2, 1], B[2, 0] = inner["C"], inner["D"]
        A[2, 2 : 2 + c] = -inner["D"] * taps
        A[range(3, 2 + c), range(2, 1 + c)] = 1.0
    A[-1, -1], C[0, -1] = pole, gain
    return A, B, C
