"""A linear controller with a state of its own over two delay chains, as a jump-linear system.

    xi(k+1) = Ac xi(k) + Bc e(k),    v(k) = Cc xi(k) + Dc e(k),    e(k) = C x(k - tau_k),    u(k) = v(k - d_k)

In deviations from the ideal plant response. Every packet carries one row, which the actuator applies whatever its age. State:
x, then the stored outputs, xi, then the rows under way, newest first; then, where a receiver may have nothing new
(`DelayChain.held`), the sample that the controller used last, and the input that was applied last.

Reference: (7.14), with xi in place of a table of gains.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from design.controllers import LinearLaw
from design.errors import FieldError
from design.jump_linear.mjls import MJLS
from design.networked_loop.initial_law import default_initial, initial_law
from design.networked_loop.joint_modes import joint_bounds, joint_modes, joint_stays
from design.networked_loop.loop_shapes import check_plant_shapes
from design.processes.delay_chain import Array, DelayChain


class DynamicLoop(NamedTuple):
    """The closed loop, bounds of its transition probabilities (None where exact), and the law of the mode at an impulse."""

    system: MJLS
    between: tuple[Array, Array] | None
    stays: tuple[Array, ...]
    initial: Array
    initial_law: str


def dynamic_loop(
    A: npt.ArrayLike,
    B: npt.ArrayLike,
    C: npt.ArrayLike,
    sc: DelayChain,
    ca: DelayChain,
    law: LinearLaw,
    *,
    input_weight: float = 0.01,
) -> DynamicLoop:
    """Return the loop of a plant, two delay chains and a linear controller; z = [C x; input_weight u], w adds to u.

    Args:
        A, B, C: (n, n), (n, m), (p, n) discrete plant (7.1).
        sc, ca: the delay chains.
        law: the controller.
        input_weight: weight of the applied input in z.

    Raises:
        ValueError: wrong shapes; the message starts with the argument's name.
    """
    A_, B_, C_ = check_plant_shapes(A, B, C)
    n, m, p = A_.shape[0], B_.shape[1], C_.shape[0]
    if law.B.shape[1] != p or law.C.shape[0] != m:
        raise FieldError("law", f"{law.B.shape[1]} inputs and {law.C.shape[0]} outputs, expected {p} and {m} for this plant")
    stored, under_way = sc.max_delay, ca.max_delay
    xi = n + stored * p
    rows = xi + law.A.shape[0]
    sample = rows + under_way * m
    last = sample + (p if sc.holds.any() else 0)
    order = last + (m if ca.holds.any() else 0)
    modes, transition = joint_modes(sc, ca)

    base = np.zeros((order, order))
    base[:n, :n] = A_
    if stored:
        base[n : n + p, :n] = C_
        base[n + p : xi, n : xi - p] = np.eye((stored - 1) * p)
    if under_way:
        base[rows + m : sample, rows : sample - m] = np.eye((under_way - 1) * m)
    closed = np.repeat(base[None], len(modes), axis=0)
    output = np.zeros((len(modes), p + m, order))
    for i, (s, c, _) in enumerate(modes):
        tau, d = int(sc.delay[s]), int(ca.delay[c])
        e = np.zeros((p, order))
        e[:, : n if tau == 0 else 0] = C_[:, : n if tau == 0 else 0]
        if sc.holds[s]:
            e = np.eye(p, order, sample)
        elif tau:
            e[:, n + (tau - 1) * p : n + tau * p] = np.eye(p)
        v = law.D @ e
        v[:, xi:rows] += law.C
        closed[i, xi:rows] += law.B @ e
        closed[i, xi:rows, xi:rows] += law.A
        if under_way:
            closed[i, rows : rows + m] += v
        u = v
        if ca.holds[c]:
            u = np.eye(m, order, last)
        elif d:
            u = np.zeros((m, order))
            u[:, rows + (d - 1) * m : rows + d * m] = np.eye(m)
        closed[i, :n] += B_ @ u
        closed[i, sample:last] = e[: last - sample]
        closed[i, last:] = u[: order - last]
        output[i, :p, :n] = C_
        output[i, p:] = input_weight * u
    drive = np.zeros((order, m))
    drive[:n] = B_
    system = MJLS(A=closed, B=drive, C=output, transition=transition)
    bounds, stays = joint_bounds(sc, ca, modes), joint_stays(sc, ca, modes)
    return DynamicLoop(system, bounds, stays, default_initial(sc, ca, modes), initial_law(sc, ca))
