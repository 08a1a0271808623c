"""The networked closed loop as a jump-linear system, (7.14), for every information pattern.

In the coordinates of deviations from the ideal plant response (7.8) the loop is

    x(k+1) = A x(k) + B [u(k) + w(k)],   u(k) = v_{d_k}(k - d_k),   v_j(k) = K[t_k, row(k, j)] Y(k)

where Y(k) is what the controller knows at slot k (the sample C x(k - tau_k), by choice also the one before it and the
integral of the measured error) and v_j(k) is the row of the send-all packet of slot k that is applied if the packet
is j slots old. The information pattern is the row index:

    constant   0                        one row, the C-A delay is not used
    generated  d_k                      as printed, (7.9)-(7.13): d when the packet was generated
    previous   d_{k-1}                  as in [53]
    applied    j                        d when the row is applied
    both       d_k * rows + j           both of them

Where several nodes measure, every output l is known as c_l x(k - tau_l) with an age of its own, and t_k says all ages.

A linear controller may have states of its own (`dynamic_loop`),

    xi(k+1) = Ac xi(k) + Bc e(k),    v_j(k) = Cc_j xi(k) + Dc_j e(k),    e_l(k) = c_l x(k - tau_l)

by the ages that it distinguishes. A table of gains is a law without a state, the integral is one.

State and matrices: `design.networked_loop.affine_loop`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt
from msgspec.structs import replace

from design.controllers import LinearLaw, RowsLaw, Selection
from design.errors import FieldError
from design.networked_loop import check_plant_shapes
from design.networked_loop.affine_loop import LoopStructure, wired
from design.processes.delay_chain import Array, DelayChain, as_chain

SELECTIONS: tuple[str, ...] = get_args(Selection)


def loop_structure(
    A: npt.ArrayLike,
    B: npt.ArrayLike,
    C: npt.ArrayLike,
    sc: DelayChain | npt.ArrayLike,
    ca: DelayChain | npt.ArrayLike,
    selection: Selection | str = "generated",
    *,
    Q: npt.ArrayLike | None = None,
    R: npt.ArrayLike | None = None,
    output: Literal["stacked", "sum"] = "stacked",
    samples: int = 1,
    integral: float = 0.0,
    store: Literal["output", "state"] = "output",
    order: int = 0,
    state_gains: npt.ArrayLike = (),
) -> LoopStructure:
    """Augment plant, network and information pattern to the jump-linear loop (7.14).

    Args:
        A, B, C: (n, n), (n, m), (p, n) discrete plant (7.1).
        sc, ca: S-C and C-A delay chains, or their transition matrices Lambda and Pi.
        selection: information pattern, see the module.
        Q: (l, n) weight of the state; default C.
        R: weight of u1(k-1), (l', m), a vector (one row), or a number (times the identity); default: the row
            0.01 .. 0.01 of Section 7.4. It weighs the newest stored row, u1(k-1) as printed, where the controller knows
            which will be applied. Where the actuator chooses it weighs the input applied in the last sample (m more
            states): there only the rows for d > 0 are stored, and R would not see the others.
        output: "stacked" is z = [Q x; R u1], "sum" is z = Q x + R u1 as printed (the two may cancel).
        samples: in one packet: Y = [y(k - tau); y(k - tau - 1); ...].
        integral: > 0 adds the integral of the measured error, xi(k+1) = xi(k) + C x(k - tau_k), at the controller: Y
            gets xi(k) as its next p entries, and z gets `integral` * xi(k) (stacked).
        store: "output" delays C x, "state" delays x as printed: same loop, more states.
        order: states of the controller's own, xi, which Y gets as its last entries. Rows of the gains behind those of the packet
            make xi(k+1), see `affine_loop.wired`.
        state_gains: (sc labels, c, entries of Y), given, in their place: xi(k+1) = state_gains Y.

    Raises:
        ValueError: wrong shapes; the message starts with the argument's name.
        TooLarge: more modes or states than second moments are computed of.
    """
    plant = check_plant_shapes(A, B, C)
    sc_chain, ca_chain, p, m = as_chain(sc, "Lambda"), as_chain(ca, "Pi"), len(plant[2]), plant[1].shape[1]
    if samples < 1:
        raise FieldError("samples", f"{samples}, expected at least 1")
    if integral < 0 or not np.isfinite(integral):
        raise FieldError("integral", f"{integral:g}, expected a finite weight >= 0")
    if selection not in SELECTIONS:
        raise FieldError("selection", f"{selection!r}, expected one of {', '.join(SELECTIONS)}")
    given, known, sums = np.asarray(state_gains, dtype=np.float64), samples * p, int(integral > 0) * p
    own = sums + (given.shape[1] if given.size else order)
    moves = np.zeros((int(sc_chain.label.max()) + 1, own, known + own))
    moves[:, :sums] = np.hstack([np.eye(sums, known), np.eye(sums, own)])
    if given.size:
        moves[:, sums:] = given
    found = wired(
        plant, sc_chain, ca_chain, selection, samples=samples, own=(moves[..., known:], moves[..., :known]), weighs_input=True,
        store=store, free=order,
    )  # fmt: skip
    states = found.base.shape[-1]
    xi = states - found.behind - own
    weight = _performance_output(
        plant[2], m, states, Q=Q, R=R, output=output, integral=integral, integral_at=xi,
        input_at=states - m if selection in ("applied", "both") else xi + own,
    )  # fmt: skip
    return replace(found, C=np.repeat(weight[None], len(found.base), axis=0))


def _performance_output(
    C: Array,
    m: int,
    order: int,
    *,
    Q: npt.ArrayLike | None,
    R: npt.ArrayLike | None,
    output: str,
    input_at: int,
    integral: float,
    integral_at: int,
) -> Array:
    """Weights of the closed-loop state in z(k).

    It is z = [Q x; R u1], or the sum Q x + R u1 that (7.14c) prints.

    Args:
        C: (p, n) output matrix, the default of Q.
        m: number of inputs; order: number of closed-loop states.
        Q: (l, n) weight of x, default C.
        R: weight of u1(k-1): (l', m), a vector (one row), or a number (times the
            identity); default the row 0.01 .. 0.01 of Section 7.4.
        output: "stacked" or "sum".
        input_at: first of the m states that R weighs, u1(k-1) of (7.16) or the applied input.
        integral: weight of the integrated error at states `integral_at`.., 0 for none; always stacked.

    DEVIATION: (7.14c) prints the sum. Q x and R u1 may cancel in it, so that large gains look cheap (the VTOL's best
    H-infinity sum has a norm of 2.58 from w to y alone). Stacked is the default, the sum is available.
    """
    n, p = C.shape[1], C.shape[0]
    state_weight = C if Q is None else np.atleast_2d(np.asarray(Q, dtype=np.float64))
    raw = np.asarray(np.full(m, 0.01) if R is None else R, dtype=np.float64)
    input_weight = raw * np.eye(m) if raw.ndim == 0 else np.atleast_2d(raw)
    for name, weight, columns, what in (("Q", state_weight, n, "states"), ("R", input_weight, m, "inputs")):
        if weight.ndim != 2 or weight.shape[1] != columns:
            raise FieldError(name, f"shape {weight.shape}, expected {columns} columns ({what})")
        if not np.isfinite(weight).all():
            raise FieldError(name, "not finite")
    of_state, of_input = np.zeros((state_weight.shape[0], order)), np.zeros((input_weight.shape[0], order))
    of_state[:, :n] = state_weight
    of_input[:, input_at : input_at + m] = input_weight
    if output == "sum":
        if of_state.shape != of_input.shape:
            raise FieldError("output", f"a sum needs as many rows in Q ({len(of_state)}) as in R ({len(of_input)})")
        z = of_state + of_input
    elif output == "stacked":
        z = np.concatenate([of_state, of_input])
    else:
        raise FieldError("output", f"{output!r}, expected 'stacked' or 'sum'")
    if integral > 0:
        accumulated = np.zeros((p, order))
        accumulated[:, integral_at : integral_at + p] = integral * np.eye(p)
        z = np.concatenate([z, accumulated])
    return z


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
) -> tuple[LoopStructure, Array]:
    """Return the loop of a plant, two delay chains and a linear controller, and the gains [Dc Cc] by which it is this loop.

    z = [C x; input_weight u], w adds to u.

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
    plant = check_plant_shapes(A, B, C)
    (n, m), p = plant[1].shape, len(plant[2])
    own = [laws.one_row()] * (int(sc.label.max()) + 1) if isinstance(laws, LinearLaw) else list(laws)
    c = own[0].A.shape[0]
    for i, law in enumerate(own):
        if law.B.shape != (c, p) or law.D.shape[1:] != (m, p) or law.C.shape != (len(law.D), m, c):
            raise FieldError(f"laws[{i}]", f"B {law.B.shape}, C {law.C.shape}, D {law.D.shape}, expected {p} inputs, {m} outputs")
    loop = wired(plant, sc, ca, selection, own=(np.array([law.A for law in own]), np.array([law.B for law in own])))
    gains = np.array([np.concatenate([law.D, law.C], axis=-1) for law in own])
    inputs, of_state = loop.applied_input(gains), np.zeros((len(loop.base), p, loop.base.shape[-1]))
    of_state[:, :, :n] = plant[2]
    output = np.concatenate([of_state, input_weight * inputs], axis=1)
    return replace(loop, C=output, gain_shape=(len(gains), gains.shape[1], m, p + c)), gains
