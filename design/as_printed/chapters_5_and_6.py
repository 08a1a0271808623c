"""Chapters 5 and 6 as printed: the gains of Section 5.4, and conditions that are not sound or cannot be met.

- Theorem 5.1, which its own example cannot meet, and the functional of Chapter 5.
- The coupler of Theorem 6.1. (6.9): the coupler's condition, which has no delay in it, and (6.10).
- (6.17): the attenuation of (6.14), in which nothing drives the weight; it does not know how long the delay is.

Nothing follows from what is met here; what replaces Chapter 6 is `design.passivity`.

Reference: Section 5.4; Chapter 6, (6.9)-(6.11), (6.14)-(6.17), Section 6.5; ERRATA 22, 26.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from design.controllers.rendered_wall import Coupler, wave_coupler
from design.controllers.wall import Contact, Material, Wall
from design.errors import FieldError
from design.jump_linear import MJLS
from design.lmi import decide
from design.lmi.program import LmiProgram, symmetric_blocks
from design.passivity import HeldDevice
from design.passivity.condition import is_passive_over
from design.passivity.transparency import distortion, low_pass

Array = npt.NDArray[np.float64]


def historical_gains() -> Array:
    """The printed gains (5.16), (4, 6, 1, 4): sensor i + 1 has just sent, x(k - j).

    The plant that they are for is `plants.delayed_states`.
    """
    rows = [
        [
            [0.0077, 0.0, 0.0, 0.0],
            [0.0213, 0.0, 0.0, 0.0102],
            [0.0285, 0.0, -0.0008, 0.0412],
            [0.0, -0.1363, 0.0908, -0.2066],
            [0.0613, 0.0929, -0.1737, 0.0],
            [0.0264, -0.0201, 0.0, -0.0329],
        ],
        [
            [0.0, -0.0955, 0.0, 0.0],
            [0.0161, -0.0366, 0.0, 0.0],
            [0.0407, 0.0467, 0.0, 0.0537],
            [0.006, 0.0, 0.0975, -0.3191],
            [0.0, 0.1049, -0.1654, -0.1838],
            [0.024, -0.0322, -0.0087, 0.0],
        ],
        [
            [0.0, 0.0, 0.0044, 0.0],
            [0.0, -0.0602, 0.0819, 0.0],
            [0.0431, 0.0482, 0.0335, 0.0],
            [-0.0199, -0.1363, 0.0, -0.2093],
            [0.0532, 0.0, -0.1446, -0.1115],
            [0.0, -0.0235, -0.0106, -0.0113],
        ],
        [
            [0.0, 0.0, 0.0, 0.1798],
            [0.0, 0.0, 0.0863, -0.0107],
            [0.0, 0.0168, 0.0305, 0.1038],
            [-0.0318, -0.1771, 0.0905, 0.0],
            [0.1151, 0.1491, 0.0, -0.2225],
            [0.0293, 0.0, -0.0018, -0.0584],
        ],
    ]
    return np.array(rows)[:, :, None, :]


def newest_gains() -> Array:
    """The printed gains (5.17) of the comparison, which use the newest sample only, (4, 1, 1, 4)."""
    return np.diag([-0.7615, -1.1651, 1.6105, 0.7005])[:, None, None, :]


def printed_functional(P: Array, Q: Array, history: Sequence[Array]) -> float:
    """Return V(0) as printed, with the sum over h from j - tau - 1 to -1. NOT SOUND with a history that is not zero.

    Args:
        P: (n, n).
        Q: (tau, n, n).
        history: x(0), x(-1), ...; what is not given is zero.
    """
    x, tau = [np.asarray(each, dtype=float) for each in history], len(Q)
    past = sum(x[-h] @ Q[j - 1] @ x[-h] for j in range(1, tau + 1) for h in range(j - tau - 1, 0) if -h < len(x))
    return float(x[0] @ P @ x[0] + past)


def stabilising_intervals(A: Array, B: Array, state: int) -> list[tuple[float, float]]:
    """Return the open intervals of k for which A + B k e' is Schur stable, e the unit vector of one state.

    Block (0, 0) of (5.9) needs (A + B K(i,0))' P (A + B K(i,0)) < P - sum Q_j - Xi < P: A + B K(i,0) must be Schur stable for
    every phase i, whatever P. The zero-element constraints (5.8) leave one number in K(i,0), so that the set of stabilising
    numbers is a set of intervals that can be computed; where it is empty the theorem is infeasible for every controller.

    The characteristic polynomial is linear in k. A root crosses the unit circle only where it is 1, -1 or a pair e^(+-it):
    at finitely many k. Between two neighbouring ones nothing changes, so that one k of each interval decides all of it.

    Args:
        A: (n, n).
        B: (n, 1).
        state: the column that k acts on, from 0.
    """
    n = len(A)
    plain = np.poly(A).astype(np.float64)
    slope = np.poly(A + B @ np.eye(n)[state : state + 1]).astype(np.float64) - plain
    crossings = _crossings(plain, slope)
    ends = [-np.inf, *sorted(set(crossings)), np.inf]
    found = []
    for low, high in pairwise(ends):
        inside = 0.5 * (low + high) if np.isfinite([low, high]).all() else (high - 1.0 if np.isfinite(high) else low + 1.0)
        if not np.isfinite([low, high]).any():
            inside = 0.0
        if np.abs(np.roots(plain + inside * slope)).max() < 1.0:
            found.append((float(low), float(high)))
    return found


def _crossings(plain: Array, slope: Array) -> list[float]:
    """Numbers k at which plain(z) + k slope(z) has a root on the unit circle."""
    # k = -plain(z)/slope(z) is real on |z| = 1 where plain(z) slope(1/z) is: an equation in z and 1/z, made a polynomial.
    product = np.convolve(plain, slope[::-1]) - np.convolve(plain[::-1], slope)
    points = [1.0 + 0j, -1.0 + 0j]
    if np.abs(product).max() > 0.0:
        roots = np.roots(product)
        points += [z / abs(z) for z in roots if abs(abs(z) - 1.0) < 1e-5]
    below = [np.polyval(slope, z) for z in points]
    return [float((-np.polyval(plain, z) / s).real) for z, s in zip(points, below) if abs(s) > 1e-12]


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


def least_real_part(device: HeldDevice, delay: int, *, twice: bool = False) -> float:
    """Return the least real part on a grid of ((z-1)/(T z) F(z) + (z-1)/(2 b z)) z^-n, which (6.10) says is positive real.

    F is the zero-order hold of the position, without a hand: the printed 1/s^2 belongs to the velocity.

    Args:
        device: m and b.
        delay: n in samples.
        twice: 1/s^2 over the position M(s), as printed, so that F integrates once too often.
    """
    A, B = device.discretise(PERIOD_S)
    z = np.exp(1j * np.pi * np.arange(1, 20_001) / 20_000)  # angles in (0, pi]
    # C (z I - A)^-1 B of a second-order A with A[1, 0] = 0
    held = B[0] / (z - A[0, 0]) + A[0, 1] * B[1] / ((z - A[0, 0]) * (z - A[1, 1]))
    if twice:  # m x + b times the integral of x is the input integrated twice
        held = (PERIOD_S**2 * (z + 1) / (2 * (z - 1) ** 2) - device.mass_kg * held) / device.damping_n_s_per_m
    b = device.damping_n_s_per_m
    value: npt.NDArray[np.complex128] = ((z - 1) / (PERIOD_S * z) * held + (z - 1) / (2 * b * z)) * z**-delay
    return float(value.real.min())


def printed_distortion(materials: Sequence[Material], transition: npt.ArrayLike, coupler: Coupler, *, cutoff_hz: float) -> MJLS:
    """Return (6.14) as printed, for a strictly proper weight: nothing drives the weight's state, so that z stays 0.

    The last rows of the printed A and B lack B_w. (6.15) to (6.17) are about this system, whose norm is 0 (ERRATA 26).

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
    n = 3 + taps.size
    state = np.eye(n + 1)  # each state and the input, and what follows of them, as a row over all of them
    own, line, weighed, omega = state[1], state[2:-2], state[-2], state[-1]
    left = (omega - taps @ line) / (1.0 + stiff * direct)  # of G/(1 + G D_c)
    inner = rate * direct / (1.0 + stiff * direct) * own + left
    force = stiff * left - rate / (1.0 + stiff * direct) * own
    A, B = np.split(np.array([omega, inner, *[force, *line][: taps.size], pole * weighed]), [n], axis=1)
    return A, B, gain * weighed[None, :n]
