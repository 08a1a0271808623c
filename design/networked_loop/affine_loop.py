"""The closed loop over two networks, affine in the gains: A_i(K) = A_i0 + sum L K R, for every information pattern.

`design.networked_loop.closed_loop` says what the loop is. A receiver may have nothing but what it had in the slot before
(`DelayChain.held`): then the controller keeps its newest sample and the actuator the input that it applied, each in a register of
its own.

State: x, then the stored samples, (those used last), the controller's own states, then the packet rows under way, newest first;
for `applied` and `both` one register per row, as long as the row's delay; (the input applied last).
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt
from msgspec import Struct

from design.controllers import row_count
from design.errors import FieldError
from design.jump_linear import MJLS
from design.networked_loop import check_gains, default_initial, joint_bounds, joint_modes, joint_stays, packet_registers
from design.processes.delay_chain import Array, DelayChain, Index

MOST_PRODUCTS = 4_000_000
"""Numbers of the terms L K R that are held at once: 32 MB."""


class _Entries(NamedTuple):
    """One term L K[sc, row] R of one mode's matrix, per index e."""

    mode: Index
    sc: Index
    row: Index
    left: Array
    right: Array


class LoopStructure(Struct, frozen=True):
    """Everything of the closed loop but the gains. Made by `wired`.

    Fields: `base` (N, n, n) matrices for zero gains; `B` (N, n, q); `C` (N, l, n); `transition` (N, N);
    `between` entrywise lower and upper bounds (N, N) of the transition probabilities, None where these are exact;
    `stays` those of stays that have lasted long, see `joint_stays`;
    `default_initial` (N,) and `initial_law`, the distribution of the mode at the H2 impulse and its name;
    `sc_mode`, `ca_mode`, `ca_before` (N,) indices of each mode's chains (`ca_before` is -1 unless the pattern is
    `previous`); `stored_outputs` samples lie behind x, then `own_states` of the controller, and packet rows and inputs in the
    last `behind` states;
    `gain_shape` = (sc labels, rows, m, py), of which the first `packet_rows` are those of a packet, and others make the
    controller's own states; `used` (sc labels, rows) says which gains can matter.
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
    behind: int
    packet_rows: int
    own_states: int
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


def wired(
    plant: tuple[Array, Array, Array],
    sc: DelayChain,
    ca: DelayChain,
    selection: str,
    *,
    own: tuple[Array, Array],
    samples: int = 1,
    weighs_input: bool = False,
    store: Literal["output", "state"] = "output",
    free: int = 0,
) -> LoopStructure:
    """Return the loop without a z: C is (N, 0, order).

    Args:
        plant: A, B and C.
        sc, ca, selection, samples, store: as of `design.networked_loop.closed_loop.loop_structure`.
        own: of the controller's own states, (labels, c, c) and (labels, c, samples p): xi(k+1) = A xi(k) + B Y(k). Y ends with
            xi(k).
        weighs_input: whether z weighs an input: the newest stored row or, where the actuator chooses, the input applied last is a
            state in any case.
        free: gains make so many of the controller's own states instead, the last ones, in rows behind those of the packet: row
            R + j, j = 0, 1, ..., gives the m states from j m on, of these and of the next slot, of Y.

    Raises:
        FieldError: states are stored and a controller keeps its sample.
        TooLarge: more modes or states than second moments are computed of.
    """
    A, B, C = plant
    n, m, p = A.shape[0], B.shape[1], C.shape[0]
    labels = int(ca.label.max()) + 1
    rows = row_count(selection, labels - 1)
    taken, delayed = (C, np.eye(p)) if store == "output" else (np.eye(n), C)
    width, depth, c = len(taken), sc.max_delay + samples - 1, own[0].shape[-1]
    inner = -(-free // m)
    keeps_samples = bool(sc.holds.any())
    if keeps_samples and store != "output":
        raise FieldError("store", f"{store!r}, but a controller that keeps its sample stores outputs")

    # where things lie in the state: x | samples k-1.. | samples used in k-1 | xi | registers
    used = n + depth * width
    xi = used + (samples * p if keeps_samples else 0)
    registers = packet_registers(selection, ca, xi + c, m) if weighs_input or ca.max_delay else {}
    last_input = xi + c + sum(length for _, length in registers.values()) * m
    per_row = selection in ("applied", "both")
    order = last_input + (m if (weighs_input and per_row) or ca.holds.any() else 0)

    modes, transition = joint_modes(sc, ca, order=order, with_previous=selection == "previous")
    N = len(modes)
    shift = np.zeros((order, order))
    shift[:n, :n] = A
    if depth:
        shift[n : n + width, :n] = taken
        shift[n + width : used, n : used - width] = np.eye((depth - 1) * width)
    for first, length in registers.values():
        tail = (length - 1) * m
        shift[first + m : first + m + tail, first : first + tail] = np.eye(tail)

    def sample(ages: Index) -> Array:
        """c_l x(k - age_l) of every output l as a function of the state."""
        reader = np.zeros((p, order))
        for l, age in enumerate(ages.tolist()):
            if age == 0:
                reader[l, :n] = C[l]
            else:
                at = n + (age - 1) * width
                reader[l, at : at + width] = delayed[l]
        return reader

    output_ages, held = sc.output_ages(p), sc.held_outputs(p)
    kept = np.eye(samples * p, order, used).reshape(samples, p, order)
    base = np.repeat(shift[None], N, axis=0)
    input_base = np.zeros((N, m, order))
    entries: list[tuple[int, int, int, Array, Array]] = []
    inputs: list[tuple[int, int, int, Array, Array]] = []
    into_plant, states = np.zeros((order, m)), np.eye(c, order, xi)
    into_plant[:n] = B
    within = (np.arange(order) < xi + c)[:, None]
    into_plant[last_input:] = np.eye(order - last_input, m)
    for i, (s, a, before) in enumerate(modes):
        tau, d, label, seen = output_ages[s], int(ca.delay[a]), int(ca.label[a]), int(sc.label[s])
        known = [sample(tau + lag) for lag in range(samples)]
        if held[s].any():
            known = [np.where(held[s][:, None], old, new) for old, new in zip(kept, known)]
        Y = np.concatenate([*known, states])
        base[i, used:xi] += Y[: xi - used]
        base[i, xi : xi + c] += own[1][seen] @ Y[: samples * p] + own[0][seen] @ states
        offset = {"generated": label, "previous": int(ca.label[before]), "both": label * labels}.get(selection, 0)
        entries += [(i, seen, rows + j, np.eye(order, m, free - xi - c - j * m) * within, Y) for j in range(inner)]
        # rows that go into a register: one per label if the actuator chooses, else the only one
        for its, (first, _) in registers.items():
            entries.append((i, seen, offset + (its if per_row else 0), np.eye(order, m, -first), Y))
        if not ca.holds[a] and d == 0:
            entries.append((i, seen, offset + (label if per_row else 0), into_plant, Y))
            inputs.append(entries[-1])
        else:
            first = last_input if ca.holds[a] else registers[label if per_row else 0][0] + (d - 1) * m
            input_base[i, :, first : first + m] = np.eye(m)
            base[i, :, first : first + m] += into_plant
    drive = np.zeros((order, m))
    drive[:n] = B
    index, (initial, law) = np.array(modes, dtype=np.int64), default_initial(sc, ca, modes)
    return LoopStructure(
        base=base, B=np.repeat(drive[None], N, axis=0), C=np.zeros((N, 0, order)), transition=transition,
        between=joint_bounds(sc, ca, modes), stays=joint_stays(sc, ca, modes), default_initial=initial, initial_law=law,
        entries=_pack(entries, order, m, samples * p + c), input_entries=_pack(inputs, order, m, samples * p + c),
        input_base=input_base, gain_shape=(len(own[0]), rows + inner, m, samples * p + c), sc_mode=index[:, 0],
        ca_mode=index[:, 1], ca_before=index[:, 2], plant_order=n, own_states=c, behind=order - xi - c,
        stored_outputs=depth + (samples if keeps_samples else 0), packet_rows=rows, selection=selection,
    )  # fmt: skip


def _pack(entries: list[tuple[int, int, int, Array, Array]], order: int, m: int, known: int) -> _Entries:
    """The entries as arrays; none of them where no packet is ever applied in the slot in which it was generated."""
    index = np.array([entry[:3] for entry in entries], dtype=np.int64).reshape(-1, 3)
    left = np.array([entry[3] for entry in entries], dtype=np.float64).reshape(-1, order, m)
    right = np.array([entry[4] for entry in entries], dtype=np.float64).reshape(-1, known, order)
    return _Entries(index[:, 0], index[:, 1], index[:, 2], left, right)
