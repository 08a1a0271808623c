"""The conditions of Chapter 6 as printed, each with ``method = "printed"`` and ``sound = False``, whatever it says.

- (6.9): the coupler's condition, which has no delay in it.
- (6.17): the attenuation of (6.14), in which nothing drives the weight; it does not know how long the delay is.

Reference: Chapter 6, (6.9), (6.14)-(6.17); ERRATA 22, 26.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np
import numpy.typing as npt

from design.as_printed.coupler import PERIOD_S, meets_printed_condition
from design.controllers.coupler import Coupler
from design.controllers.wall import Material
from design.errors import FieldError
from design.lmi.decision import decide
from design.lmi.program import LmiProgram, symmetric_blocks
from design.passivity.transparency import low_pass

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class PrintedVerdict:
    """What a printed condition says; nothing follows from it.

    Args:
        condition: its number in the thesis.
        holds: whether it holds.
        number: the number that it is about.
        quantity: what the number is, with its unit.
    """

    condition: str
    holds: bool
    number: float
    quantity: str
    method: Literal["printed"] = "printed"
    sound: Literal[False] = False


def printed_stability(coupler: Coupler, damping_n_s_per_m: float) -> PrintedVerdict:
    """Return what (6.9) says of a coupler, over any delay.

    Args:
        coupler: C.
        damping_n_s_per_m: b in N s/m.
    """
    return PrintedVerdict(
        condition="(6.9)", holds=meets_printed_condition(coupler, damping_n_s_per_m), number=PERIOD_S / (2.0 * damping_n_s_per_m),
        quantity="T/(2 b), m/N",
    )  # fmt: skip


def printed_attenuation(
    materials: Sequence[Material], transition: npt.ArrayLike, coupler: Coupler, *, cutoff_hz: float, gamma: float
) -> PrintedVerdict:
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
        program.require(
            f"(6.17) {i}", partial(_left_side, mode=i, data=modes[i], row=chain[i], gamma=gamma), "Q", *names
        )
    found = decide(program, verify_with="nothing")
    return PrintedVerdict(condition="(6.17)", holds=found.holds, number=gamma, quantity="level, N/m")


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
