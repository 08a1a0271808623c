r"""How a rendered wall feels beside the one that was meant: what a material spares the coupler, and the distortion (6.12).

A coupler per material, C_i(z) = C(z) - s_i: what a material gives itself is spared the coupler.

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

The distortion has the delay in the state, and all materials at once:

    z = W(z) ( G_i(z) - z^-nd G_i(z)/(1 + G_i(z) C(z)) ) omega,     G_i = K_i + B_i (z - 1)/(T z)

is one jump-linear system over the materials. Its norm is exact (`design.jump_linear.bounded_real`), where (6.17) bounds another
system: (6.14) leaves W undriven, and the printed inequality does not know how long the delay is.

Reference: Chapter 6, 6.4, (6.12)-(6.17); Theorem 6.1; ERRATA 22, 23.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from design.controllers.rendered_wall import Coupler
from design.controllers.wall import Material
from design.errors import FieldError
from design.jump_linear import MJLS


def low_pass(cutoff_hz: float, period_s: float) -> tuple[float, float]:
    """Return a and g of W(z) = g/(z - a), a first-order low-pass of gain 1 at zero frequency.

    Args:
        cutoff_hz: corner frequency in Hz.
        period_s: T in s.
    """
    a = float(np.exp(-2.0 * np.pi * cutoff_hz * period_s))
    return a, 1.0 - a


def distortion(
    materials: Sequence[Material],
    transition: npt.ArrayLike,
    coupler: Coupler,
    *,
    period_s: float,
    delay: int,
    cutoff_hz: float,
) -> MJLS:
    """Return the jump-linear system from the position omega in m to the weighted error z of the force in N.

    State: (omega(k-1), x_v(k-1), f(k-1) .. f(k-M), w).

    Args:
        materials: one per mode.
        transition: Lambda.
        coupler: C, without an integrator.
        period_s: T in s.
        delay: nd in samples.
        cutoff_hz: of the weight W, in Hz.

    Raises:
        ValueError: the coupler has an integrator.
    """
    if coupler.integrator_m_per_n:
        raise FieldError("coupler", "has an integrator, expected a finite impulse response")
    taps, (pole, gain) = coupler.taps_m_per_n, low_pass(cutoff_hz, period_s)
    memory = max(len(taps) - 1, delay)
    n = 2 + memory + 1
    state = np.eye(n + 1)  # each state and the input, and what follows of them, as a row over all of them
    before, avatar_before, forces, weighed, omega = state[0], state[1], state[2:-2], state[-2], state[-1]
    past = np.array(taps[1:]) @ forces[: len(taps) - 1]
    both = []
    for m in materials:
        rate, direct = m.damping_n_s_per_m / period_s, taps[0] - m.spared_m_per_n
        stiff = m.stiffness_n_per_m + rate
        force = (stiff * (omega - past) - rate * avatar_before) / (1.0 + stiff * direct)
        error = stiff * omega - rate * before - np.vstack([force, forces])[delay]
        last = pole * weighed + gain * error
        both.append([omega, omega - past - direct * force, *[force, *forces][:memory], last])
    A, B = np.split(np.array(both), [n], axis=2)
    C = np.zeros((1, n))
    C[0, -1] = 1.0
    return MJLS(A=A, B=B, C=C, transition=transition)


def distortion_bound(material: Material, *, period_s: float, delay: int, cutoff_hz: float) -> float:
    """Return a bound in N/m below which no causal rendering brings (6.12): it can do nothing in the first nd samples.

    The error's first nd samples are those of W G whatever the coupler; by Caratheodory and Fejer the norm of their Toeplitz
    matrix is the least norm that a function with these samples can have.

    Args:
        material: K and B.
        period_s: T in s.
        delay: nd in samples.
        cutoff_hz: of W, in Hz.
    """
    if delay == 0:
        return 0.0
    pole, gain = low_pass(cutoff_hz, period_s)
    rate = material.damping_n_s_per_m / period_s
    # W without its own step: what counts is where the error begins
    samples = np.convolve(gain * pole ** np.arange(delay), [material.stiffness_n_per_m + rate, -rate])
    toeplitz = np.array([[samples[i - j] if i >= j else 0.0 for j in range(delay)] for i in range(delay)])
    return float(np.linalg.norm(toeplitz, 2))


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
    """Return 1/(1/K + C_i(1)) in N/m: how stiff a material feels under a constant force; 0 behind an integrator, inf if rigid.

    Args:
        material: K, and what it spares the coupler.
        coupler: C.
    """
    yields = 1.0 / material.stiffness_n_per_m + coupler.static_compliance_m_per_n - material.spared_m_per_n
    return 1.0 / yields if yields else math.inf
