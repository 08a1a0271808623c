"""A linear controller with a state of its own over two delay chains, as a jump-linear system.

    xi(k+1) = Ac xi(k) + Bc e(k),    v_j(k) = Cc_j xi(k) + Dc_j e(k),    e_l(k) = c_l x(k - tau_l),    u(k) = v_{j}(k - d_k)

In deviations from the ideal plant response. The matrices are those of the ages that the controller distinguishes; the row j is
picked as the information pattern says, see `design.networked_loop.closed_loop`. State: x, then the stored outputs, xi, then the
rows under way, newest first; then, where a receiver may have nothing new (`DelayChain.held`), the samples that the controller
used last, and the input that was applied last. A table of gains is a law without a state.

Reference: (7.14), with xi in place of a table of gains.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from design.controllers import LinearLaw, RowsLaw
from design.errors import FieldError
from design.jump_linear.mjls import MJLS
from design.networked_loop.loop_parts import (
    check_plant_shapes,
    default_initial,
    initial_law,
    joint_bounds,
    joint_modes,
    joint_stays,
    packet_registers,
)
from design.processes.delay_chain import Array, DelayChain


class DynamicLoop(NamedTuple):
    """The closed loop, bounds of its transition probabilities (None where exact), and the law of the mode at an impulse.

    `inputs` (N, m, order) with u(k) = U_i X(k); `standing` (order, n), the state of the loop whose plant has stood at x, with the
    controller's state and all rows at 0.
    """

    system: MJLS
    between: tuple[Array, Array] | None
    stays: tuple[Array, ...]
    initial: Array
    initial_law: str
    inputs: Array
    standing: Array


def dynamic_loop(
    A: npt.ArrayLike,
    B: npt.ArrayLike,
    C: npt.ArrayLike,
    sc: DelayChain,
    ca: DelayChain,
    laws: LinearLaw | Sequence[RowsLaw],
    selection: str = "constant",
    *,
    input_weight: float = 0.01,
) -> DynamicLoop:
    """Return the loop of a plant, two delay chains and a linear controller; z = [C x; input_weight u], w adds to u.

    Args:
        A, B, C: (n, n), (n, m), (p, n) discrete plant (7.1).
        sc, ca: the delay chains.
        laws: the controller, or one for every label of the S-C chain.
        selection: how a row of a packet is picked.
        input_weight: weight of the applied input in z.

    Raises:
        ValueError: wrong shapes; the message starts with the argument's name.
        TooLarge: more modes or states than second moments are computed of.
    """
    A_, B_, C_ = check_plant_shapes(A, B, C)
    n, m, p = A_.shape[0], B_.shape[1], C_.shape[0]
    own = [laws.one_row()] * (int(sc.label.max()) + 1) if isinstance(laws, LinearLaw) else list(laws)
    c, labels = own[0].A.shape[0], int(ca.label.max()) + 1
    for i, law in enumerate(own):
        if law.B.shape != (c, p) or law.D.shape[1:] != (m, p) or law.C.shape != (len(law.D), m, c):
            raise FieldError(f"laws[{i}]", f"B {law.B.shape}, C {law.C.shape}, D {law.D.shape}, expected {p} inputs, {m} outputs")
    rows_under = packet_registers(selection, ca, 0, m)
    length = sum(count for _, count in rows_under) * m if ca.max_delay else 0
    stored = sc.max_delay
    xi = n + stored * p
    rows = xi + c
    sample = rows + length
    last = sample + (p if sc.holds.any() else 0)
    order = last + (m if ca.holds.any() else 0)
    modes, transition = joint_modes(sc, ca, order=order, with_previous=selection == "previous")

    base = np.zeros((order, order))
    base[:n, :n] = A_
    if stored:
        base[n : n + p, :n] = C_
        base[n + p : xi, n : xi - p] = np.eye((stored - 1) * p)
    for first, count in rows_under if length else ():
        at, tail = rows + first, (count - 1) * m
        base[at + m : at + m + tail, at : at + tail] = np.eye(tail)
    closed = np.repeat(base[None], len(modes), axis=0)
    output, inputs = np.zeros((len(modes), p + m, order)), np.zeros((len(modes), m, order))
    ages, held = sc.output_ages(p), sc.held_outputs(p)
    for i, (s, a, before) in enumerate(modes):
        e = np.zeros((p, order))
        for l, age in enumerate(ages[s].tolist()):
            if held[s, l]:
                e[l, sample + l] = 1.0
            elif age:
                e[l, n + (age - 1) * p + l] = 1.0
            else:
                e[l, :n] = C_[l]
        law, d, label = own[int(sc.label[s])], int(ca.delay[a]), int(ca.label[a])
        v = law.D @ e
        v[:, :, xi:rows] += law.C
        closed[i, xi:rows] += law.B @ e
        closed[i, xi:rows, xi:rows] += law.A
        offset = {"generated": label, "previous": int(ca.label[before]), "both": label * labels}.get(selection, 0)
        per_row = selection in ("applied", "both")
        for at, (first, _) in enumerate(rows_under) if length else ():
            closed[i, rows + first : rows + first + m] += v[offset + (rows_under.labels[at] if per_row else 0)]
        u = np.zeros((m, order))
        if ca.holds[a]:
            u = np.eye(m, order, last)
        elif d:
            at = rows + rows_under.first_of(label if per_row else 0) + (d - 1) * m
            u[:, at : at + m] = np.eye(m)
        else:
            u = v[offset + (label if per_row else 0)]
        closed[i, :n] += B_ @ u
        closed[i, sample:last] = e[: last - sample]
        closed[i, last:] = u[: order - last]
        output[i, :p, :n] = C_
        inputs[i], output[i, p:] = u, input_weight * u
    drive = np.zeros((order, m))
    drive[:n] = B_
    system = MJLS(A=closed, B=drive, C=output, transition=transition)
    bounds, stays = joint_bounds(sc, ca, modes), joint_stays(sc, ca, modes)
    standing = np.zeros((order, n))
    standing[:n], standing[n:xi] = np.eye(n), np.tile(C_, (stored, 1))
    standing[sample:last] = C_[: last - sample]
    return DynamicLoop(system, bounds, stays, default_initial(sc, ca, modes), initial_law(sc, ca), inputs, standing)
