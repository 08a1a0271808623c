"""The networked closed loop as a jump-linear system, (7.14), for every information pattern.

In the coordinates of deviations from the ideal plant response (7.8) the loop is

    x(k+1) = A x(k) + B [u(k) + w(k)],   u(k) = v_{d_k}(k - d_k),   v_j(k) = K[t_k, row(k, j)] Y(k)

where Y(k) is what the controller knows at tick k (the sample C x(k - tau_k), by choice also the one before it and the
integral of the measured error) and v_j(k) is the row of the send-all packet of tick k that is applied if the packet
is j ticks old. The information pattern is the row index:

    constant   0                        one row, the C-A delay is not used
    generated  d_k                      as printed, (7.9)-(7.13): d when the packet was generated
    previous   d_{k-1}                  as in [53]
    applied    j                        d when the row is applied
    both       d_k * rows + j           both of them

Where several nodes measure, every output l is known as c_l x(k - tau_l) with an age of its own, and t_k says all ages.

A receiver may have nothing but what it had in the slot before (`DelayChain.held`): then the controller keeps its newest sample
and the actuator the input that it applied, each in a register of its own.

State: x, then the stored samples, (those used last), (the integral), then the packet rows under way, newest first; for
`applied` and `both` one register per row, as long as the row's delay; (the input applied last).
The loop is affine in the gains: A_i(K) = A_i0 + sum L K R.
"""

from __future__ import annotations

from typing import Literal, NamedTuple, get_args

import numpy as np
import numpy.typing as npt
from msgspec import Struct

from design.controllers import Selection, row_count
from design.errors import FieldError
from design.jump_linear.mjls import MJLS
from design.networked_loop.loop_parts import (
    check_gains,
    check_plant_shapes,
    default_initial,
    initial_law,
    joint_bounds,
    joint_modes,
    joint_stays,
    packet_registers,
    performance_output,
)
from design.processes.delay_chain import Array, DelayChain, Index, as_chain

MOST_PRODUCTS = 4_000_000
"""Numbers of the terms L K R that are held at once: 32 MB."""
SELECTIONS: tuple[str, ...] = get_args(Selection)


class _Entries(NamedTuple):
    """One term L K[sc, row] R of one mode's matrix, per index e."""

    mode: Index
    sc: Index
    row: Index
    left: Array
    right: Array


class LoopStructure(Struct, frozen=True):
    """Everything of the closed loop but the gains. Made by `loop_structure`.

    Fields: `base` (N, n, n) matrices for zero gains; `B` (N, n, q); `C` (N, l, n); `transition` (N, N);
    `between` entrywise lower and upper bounds (N, N) of the transition probabilities, None where these are exact;
    `stays` those of stays that have lasted long, see `joint_stays`;
    `default_initial` (N,) and `initial_law`, the distribution of the mode at the H2 impulse and its name;
    `sc_mode`, `ca_mode`, `ca_before` (N,) indices of each mode's chains (`ca_before` is -1 unless the pattern is
    `previous`); `stored_outputs` samples lie behind x; `gain_shape` = (sc labels, rows, m, py);
    `used` (sc labels, rows) says which gains can matter.
    """

    base: Array
    B: Array
    C: Array
    transition: Array
    between: tuple[Array, Array] | None
    stays: tuple[Array, ...]
    default_initial: Array
    initial_law: str
    entries: _Entries
    input_entries: _Entries
    input_base: Array
    gain_shape: tuple[int, int, int, int]
    sc_mode: Index
    ca_mode: Index
    ca_before: Index
    plant_order: int
    stored_outputs: int
    integral: bool
    selection: str

    @property
    def used(self) -> npt.NDArray[np.bool_]:
        """(sc labels, rows): gains that enter the loop; the others have no effect."""
        mask = np.zeros(self.gain_shape[:2], dtype=bool)
        mask[self.entries.sc, self.entries.row] = True
        return mask

    def matrices(self, gains: Array, rows: Index | None = None) -> Array:
        """(N, n, n) closed-loop matrices for gains K of shape `gain_shape`; `rows` stand for those of the entries."""
        e = self.entries
        A = self.base.copy()
        row, part = e.row if rows is None else rows, max(1, MOST_PRODUCTS // A[0].size)
        for at in (slice(first, first + part) for first in range(0, len(e.mode), part)):
            np.add.at(A, e.mode[at], e.left[at] @ gains[e.sc[at], row[at]] @ e.right[at])
        return A

    def gain_gradient(self, gradient_A: Array) -> Array:
        """Derivative with respect to the gains from the one with respect to the mode matrices."""
        e = self.entries
        gradient = np.zeros(self.gain_shape)
        np.add.at(gradient, (e.sc, e.row), e.left.transpose(0, 2, 1) @ gradient_A[e.mode] @ e.right.transpose(0, 2, 1))
        return gradient

    def gain_curvature(self, cost: Array, moments: Array, block: Index) -> Array:
        """Second derivative, with respect to gains, of sum_i tr(A_i' cost_i A_i moments_i) / 2.

        Args:
            cost, moments: (N, n, n), held fixed.
            block: (sc labels, rows), number of the free gain that stands there; gains of one number are equal.

        Returns:
            (blocks m py, blocks m py), the entries of a gain row by row.
        """
        e, (m, py) = self.entries, self.gain_shape[2:]
        own, count, size = block[e.sc, e.row], int(block.max()) + 1, m * py
        curvature = np.zeros((count, size, count, size))
        for mode in np.unique(e.mode):
            its = np.flatnonzero(e.mode == mode)
            left, right, number = e.left[its], e.right[its], own[its]
            by_input = left.transpose(0, 2, 1)[:, None] @ (cost[mode] @ left)[None]
            by_sample = right[:, None] @ (moments[mode] @ right.transpose(0, 2, 1))[None]
            pairs = np.einsum("abij,abkl->abikjl", by_input, by_sample).reshape(len(its), len(its), size, size)
            for one, two in np.ndindex(len(its), len(its)):  # an index may come twice
                curvature[number[one], :, number[two], :] += pairs[one, two]
        return curvature.reshape(count * size, count * size)

    def applied_input(self, gains: Array) -> Array:
        """(N, m, n) matrices U_i with u(k) = U_i X(k), the (deviation of the) input that acts on the plant."""
        e = self.input_entries
        U = self.input_base.copy()
        np.add.at(U, e.mode, gains[e.sc, e.row] @ e.right)
        return U

    def standing(self, C: Array) -> Array:
        """(order, n): the state of the loop whose plant has stood at x, with y = C x, and no packet under way."""
        n, samples = self.plant_order, self.stored_outputs * len(C)
        found = np.zeros((self.base.shape[-1], n))
        found[:n], found[n : n + samples] = np.eye(n), np.tile(C, (self.stored_outputs, 1))
        return found

    def system(self, gains: npt.ArrayLike) -> MJLS:
        """The closed loop for the given gains."""
        A = self.matrices(check_gains(gains, self.gain_shape))
        return MJLS(A=A, B=self.B, C=self.C, transition=self.transition)


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
            gets xi(k) as its last p entries, and z gets `integral` * xi(k) (stacked).
        store: "output" delays C x, "state" delays x as printed: same loop, more states.

    Raises:
        ValueError: wrong shapes; the message starts with the argument's name.
        TooLarge: more modes or states than second moments are computed of.
    """
    A_, B_, C_ = check_plant_shapes(A, B, C)
    n, m, p = A_.shape[0], B_.shape[1], C_.shape[0]
    sc_chain, ca_chain = as_chain(sc, "Lambda"), as_chain(ca, "Pi")
    if samples < 1:
        raise FieldError("samples", f"{samples}, expected at least 1")
    if integral < 0 or not np.isfinite(integral):
        raise FieldError("integral", f"{integral:g}, expected a finite weight >= 0")
    labels = int(ca_chain.label.max()) + 1
    if selection not in SELECTIONS:
        raise FieldError("selection", f"{selection!r}, expected one of {', '.join(SELECTIONS)}")
    rows = row_count(selection, labels - 1)
    taken = C_ if store == "output" else np.eye(n)
    width = taken.shape[0]
    depth = sc_chain.max_delay + samples - 1
    keeps_samples, keeps_input = bool(sc_chain.holds.any()), bool(ca_chain.holds.any())
    if keeps_samples and store != "output":
        raise FieldError("store", f"{store!r}, but a controller that keeps its sample stores outputs")

    # where things lie in the state: x | samples k-1.. | samples used in k-1 | xi | registers
    used = n + depth * width
    xi = used + (samples * p if keeps_samples else 0)
    start = xi + (p if integral > 0 else 0)
    registers = packet_registers(selection, ca_chain, start, m)
    weighs_applied = selection in ("applied", "both")
    last_input = start + sum(length for _, length in registers) * m
    order = last_input + (m if weighs_applied or keeps_input else 0)

    modes, transition = joint_modes(sc_chain, ca_chain, order=order, with_previous=selection == "previous")
    N = len(modes)
    shift = np.zeros((order, order))
    shift[:n, :n] = A_
    if depth:
        shift[n : n + width, :n] = taken
        shift[n + width : used, n : used - width] = np.eye((depth - 1) * width)
    for first, length in registers:
        tail = (length - 1) * m
        shift[first + m : first + m + tail, first : first + tail] = np.eye(tail)

    delayed = np.eye(p) if store == "output" else C_

    def sample(ages: Index) -> Array:
        """c_l x(k - age_l) of every output l as a function of the state."""
        reader = np.zeros((p, order))
        for l, age in enumerate(ages.tolist()):
            if age == 0:
                reader[l, :n] = C_[l]
            else:
                at = n + (age - 1) * width
                reader[l, at : at + width] = delayed[l]
        return reader

    output_ages, held = sc_chain.output_ages(p), sc_chain.held_outputs(p)
    kept = np.eye(samples * p, order, used).reshape(samples, p, order)
    base = np.repeat(shift[None], N, axis=0)
    input_base = np.zeros((N, m, order))
    entries: list[tuple[int, int, int, Array, Array]] = []
    inputs: list[tuple[int, int, int, Array, Array]] = []
    into_plant = np.zeros((order, m))
    into_plant[:n] = B_
    into_plant[last_input:] = np.eye(order - last_input, m)
    for i, (s, c, before) in enumerate(modes):
        tau, d, label = output_ages[s], int(ca_chain.delay[c]), int(ca_chain.label[c])
        known = [sample(tau + lag) for lag in range(samples)]
        if held[s].any():
            known = [np.where(held[s][:, None], old, new) for old, new in zip(kept, known)]
        if keeps_samples:
            base[i, used:xi] += np.concatenate(known)
        if integral > 0:
            reader = np.zeros((p, order))
            reader[:, xi : xi + p] = np.eye(p)
            base[i, xi : xi + p] += known[0] + reader
            known.append(reader)
        Y = np.concatenate(known)
        generated = {"generated": label, "previous": int(ca_chain.label[before]), "both": label * labels}
        offset = generated.get(selection, 0)
        per_row = selection in ("applied", "both")
        # rows that go into a register: one per label if the actuator chooses, else the only one
        for slot, (first, _) in enumerate(registers):
            store_at = np.zeros((order, m))
            store_at[first : first + m] = np.eye(m)
            choice = registers.labels[slot] if per_row else 0
            entries.append((i, int(sc_chain.label[s]), offset + choice, store_at, Y))
        if ca_chain.holds[c]:
            input_base[i, :, last_input : last_input + m] = np.eye(m)
            base[i, :, last_input : last_input + m] += into_plant
        elif d == 0:
            term = (i, int(sc_chain.label[s]), offset + (label if per_row else 0), into_plant, Y)
            entries.append(term)
            inputs.append(term)
        else:
            first = registers.first_of(label if per_row else 0) + (d - 1) * m
            input_base[i, :, first : first + m] = np.eye(m)
            base[i, :, first : first + m] += into_plant
    input_at = last_input if weighs_applied else registers[0][0]
    weight = performance_output(C_, m, order, Q=Q, R=R, output=output, input_at=input_at, integral=integral, integral_at=xi)
    drive = np.zeros((order, m))
    drive[:n] = B_
    known_size = p * (samples + (1 if integral > 0 else 0))
    sc_labels = int(sc_chain.label.max()) + 1
    index = np.array(modes, dtype=np.int64)
    return LoopStructure(
        base=base,
        B=np.repeat(drive[None], N, axis=0),
        C=np.repeat(weight[None], N, axis=0),
        transition=transition,
        between=joint_bounds(sc_chain, ca_chain, modes),
        stays=joint_stays(sc_chain, ca_chain, modes),
        default_initial=default_initial(sc_chain, ca_chain, modes),
        initial_law=initial_law(sc_chain, ca_chain),
        entries=_pack(entries, order, m, known_size),
        input_entries=_pack(inputs, order, m, known_size),
        input_base=input_base,
        gain_shape=(sc_labels, rows, m, known_size),
        sc_mode=index[:, 0],
        ca_mode=index[:, 1],
        ca_before=index[:, 2],
        plant_order=n,
        stored_outputs=depth + (samples if keeps_samples else 0),
        integral=integral > 0,
        selection=selection,
    )


def _pack(entries: list[tuple[int, int, int, Array, Array]], order: int, m: int, known: int) -> _Entries:
    """The entries as arrays; none of them where no packet is ever applied in the slot in which it was generated."""
    index = np.array([entry[:3] for entry in entries], dtype=np.int64).reshape(-1, 3)
    left = np.array([entry[3] for entry in entries], dtype=np.float64).reshape(-1, order, m)
    right = np.array([entry[4] for entry in entries], dtype=np.float64).reshape(-1, known, order)
    return _Entries(index[:, 0], index[:, 1], index[:, 2], left, right)
