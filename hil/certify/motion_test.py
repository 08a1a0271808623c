"""The test of a plant before a run: its motion is compared with that of its model, with inputs and without.

With the same seed a plant has the same noise and the same load, so the difference of two runs is free of both, and

    dx(k+1) = A dx(k) + A_1 dx(k-1) + ... + B u(k),    dy(k) = C dx(k)

must hold to rounding, at inputs of every size. The motion without inputs is judged separately: see `free_motion`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from msgspec import Struct

from design.controllers import LoopModel
from design.verdict import State
from hil.rig.loop import CANCELS, EQUAL, LARGEST, Array, Free, FreeMotion, kind_of
from plants.parts.protocols import Plant

SLOTS = 200
"""Slots of every run of the test; fewer where a motion grows beyond what floats resolve."""
SHORT = 60
"""Slots in which a second run of one seed is compared with the first, and over which a state's limit is reached."""
SMALL, FREE_SIZES = 1e-3, (1e-3, 1.0, 1e3, 1e6)
"""Share of a limit that counts as small; without limits, the sizes of the inputs, in their units."""
SEED = 20240301
FIRST = 5
"""Slots in which a motion has begun that is 0 at first."""
ALIKE = 1e-2
"""A difference up to this share may come from a coarse integrator: the verdict is undecided, not refused."""


class Track(Struct, frozen=True, kw_only=True):
    """States (k, n') and outputs (k, p) of a run, slot by slot; and the inputs that the plant says it applied, (k - 1, m)."""

    states: Array
    outputs: Array
    applied: Array


class Departure(Struct, frozen=True, kw_only=True):
    """How far a plant is from its model under inputs of one size.

    Args:
        size: largest input as a multiple of the unit of every input.
        share: largest difference as a share of the motion that the model foretells.
        slot: slot in which the difference passes `EQUAL` first.
        signal: name and unit of the signal that differs most.
        found, foretold: its motion there, and the model's.
        slots: slots that were compared.
    """

    size: float
    share: float
    slot: int
    signal: tuple[str, str]
    found: float
    foretold: float
    slots: int


def drive(
    plant: Plant, period_ns: int, inputs: Array, seed: int = SEED, disturbances: Array | None = None,
    raised: list[Exception] | None = None,
) -> Track:  # fmt: skip
    """Return what a plant does, driven as a rig drives it; it ends where a number is not finite.

    Args:
        plant: what runs.
        period_ns: length of a slot, ns.
        inputs: (k, m).
        seed: of the plant's random numbers.
        disturbances: what comes on top of the inputs, (k, m); by default nothing.
        raised: takes what the plant raises in a slot, which then ends the track, too; by default it goes through.
    """
    run, beside = plant.start(np.random.default_rng(seed)), np.zeros(inputs.shape) if disturbances is None else disturbances
    states, outputs, applied = [run.state], [run.measure()], []
    for u, w in zip(inputs.tolist(), beside.tolist()):
        try:
            run.advance(period_ns, tuple(u), tuple(w))
            y, x = run.measure(), run.state
        except Exception as error:
            if raised is None:
                raise
            raised.append(error)
            break
        states.append(x)
        outputs.append(y)
        applied.append(run.applied)
        if not abs(sum(x)) + abs(sum(y)) < LARGEST:
            break
    of_inputs = np.array(applied, dtype=float).reshape(len(applied), inputs.shape[1])
    return Track(states=np.array(states, dtype=float), outputs=np.array(outputs, dtype=float), applied=of_inputs)


def random_inputs(slots: int, inputs: int) -> Array:
    """Return inputs of size 1 that change every slot in places and rest in others, of either sign, (slots, inputs)."""
    rng = np.random.default_rng(SEED + 1)
    found = rng.uniform(-1.0, 1.0, (slots, inputs))
    for column in found.T:
        k = 0
        while k < slots:
            held = int(rng.choice((1, 1, 2, 5, 20)))
            column[k : k + held] = column[k]
            k += held
        column /= np.where(column > 0.0, column.max(), -column.min())  # both limits are reached
    return found


def foretold(model: LoopModel, delayed: Array, inputs: Array) -> Array:
    """Return dx(0), dx(1), ... of the model under inputs (k, m), from rest, (k + 1, n)."""
    A, B, n = model.A, model.B, len(model.A)
    x = np.zeros((len(inputs) + 1 + len(delayed), n))
    first = len(delayed)
    x[first + 1 :] = inputs @ B.T
    for k in range(first, len(x) - 1):
        x[k + 1] += A @ x[k]
        for i, matrix in enumerate(delayed, start=1):
            x[k + 1] += matrix @ x[k - i]
    return x[first:]


def so_far(signals: Array) -> Array:
    """Return the largest signal up to every slot, of the first `FIRST` slots at least; signals (k, ...), (k, 1, ...).

    What comes later is no scale: the motion of an unstable plant ends 1e30 times as large as it began.
    """
    largest = np.maximum.accumulate(np.abs(signals).max(axis=tuple(range(1, signals.ndim)), keepdims=True)) + 1e-290
    return np.asarray(np.maximum(largest, largest[:FIRST].max()))


def departure(
    plant: Plant, model: LoopModel, of_unit: Array, free: Track, shape: Array, unit: Array, size: float, bounds: Sequence[float]
) -> Departure:
    """Return how far a plant departs from its model under inputs of one size.

    Args:
        plant: what runs.
        model: what it says of itself, at the period of the loop.
        of_unit: what the model foretells of inputs of its unit, (slots + 1, n), see `foretold`; it is linear.
        free: the same plant without inputs.
        shape: inputs of size 1, (slots, m).
        unit: (m,) unit of every input.
        size: times the unit.
        bounds: (n,) largest motion of every state that is asked for, inf where there is none.
    """
    slots = len(free.states) - 1
    inputs = shape[:slots] * unit * size
    with np.errstate(over="ignore", invalid="ignore"):
        x = of_unit[: slots + 1] * size
        beyond = ~(np.abs(x) < np.minimum(LARGEST, bounds)).all(axis=1)
    kept = int(beyond.argmax()) if beyond.any() else len(x)
    inputs, x = inputs[: max(kept - 1, 1)], x[: max(kept, 2)]
    raised: list[Exception] = []
    driven = drive(plant, round(model.period_s * 1e9), inputs, raised=raised)
    pairs = [(driven.outputs, free.outputs, x @ model.C.T, [tuple(s) for s in plant.outputs])]
    if driven.states.shape[1] == x.shape[1]:
        pairs.append((driven.states, free.states, x, [tuple(s) for s in plant.states]))
    applied = driven.applied
    put_out = np.abs(applied - inputs[: len(applied)]) > EQUAL * size * unit
    if put_out.any():
        at, j = divmod(int(put_out.argmax()), put_out.shape[1])
        what, name = (str(each) for each in plant.inputs[j])
        return Departure(
            size=size, share=np.inf, slot=at, signal=(f"applied {what}", name), found=float(applied[at, j]),
            foretold=float(inputs[at, j]), slots=len(x) - 1,
        )  # fmt: skip
    worst = Departure(size=size, share=0.0, slot=0, signal=("", ""), found=0.0, foretold=0.0, slots=len(x) - 1)
    unseen = so_far(x) * float(np.abs(model.C).max())
    for moved, rest, expected, signals in pairs:
        count = min(len(moved), len(rest), len(expected))
        moved, rest, expected = moved[:count], rest[:count], expected[:count]
        reached = np.maximum.accumulate(np.abs(expected))
        scale = reached + 1e-9 * np.maximum(unseen[:count], so_far(expected))
        lost = CANCELS * np.maximum.accumulate(np.maximum(np.abs(moved), np.abs(rest)))
        with np.errstate(invalid="ignore", over="ignore"):
            apart = np.nan_to_num(np.abs(moved - rest - expected) - lost, nan=np.inf) / scale
        k, i = np.unravel_index(int(apart.argmax()), apart.shape)
        if apart[k, i] > max(worst.share, 0.0):
            first = int((apart > EQUAL).any(axis=1).argmax()) if apart[k, i] > EQUAL else int(k)
            j = int(apart[first].argmax())
            worst = Departure(
                size=size, share=float(apart[k, i]), slot=first, signal=(str(signals[j][0]), str(signals[j][1])),
                found=float(moved[first, j] - rest[first, j]), foretold=float(expected[first, j]), slots=count - 1,
            )  # fmt: skip
    if raised and worst.share <= EQUAL:
        raise raised[0]
    return worst


def later_answer(plant: Plant, period_ns: int, free: Track, inputs: Array) -> float:
    """Return how much the motion that inputs cause differs where they begin later, as a share of it: 0 for a linear plant.

    One that is not linear and does not rest at its start meets them at another place.

    Args:
        plant: what runs.
        period_ns: length of a slot, ns.
        free: the same plant without inputs.
        inputs: (k, m), small ones.
    """
    count = min(SHORT, (len(free.outputs) - 1) // 2)
    causes = []
    for first in (0, count):
        rest = np.zeros((first, inputs.shape[1]))
        outputs = drive(plant, period_ns, np.vstack([rest, inputs[:count]]), raised=[]).outputs[first:]
        causes.append((outputs - free.outputs[first : first + len(outputs)], np.abs(outputs).max()))
    (soon, size), (late, later) = causes
    if len(late) != len(soon):  # it broke, or grew beyond what floats resolve
        return 0.0
    apart = np.abs(late - soon) - CANCELS * max(size, later)
    return float((apart / so_far(soon)).max())


def by_size(shares: Sequence[float], alike: str, difference: str) -> tuple[State, str] | None:
    """Return that a part is no linear one where it is what it says under small or large signals alone; None for another one.

    Args:
        shares: largest difference for every size of the signals, increasing, as a share; one at least is no rounding.
        alike: what it is where it is as it says, with a place for ``small`` or ``large``.
        difference: where it is not.
    """
    if shares[0] <= EQUAL:
        return "undecided", f"non-linear: {alike.format('small')}, but {difference}"
    if shares[-1] < 0.1 * shares[0] and shares[-1] < ALIKE:
        return "undecided", f"non-linear: {alike.format('large')}, but {difference}"
    return None


def free_motion(
    model: LoopModel, delayed: Array, history: Array, track: Track, other: Track, names: tuple[list[tuple[str, str]], ...]
) -> FreeMotion:
    """Return the kind of the motion that a plant has without inputs beyond its model.

    A load moves the point of rest and noise scatters around it: neither affects stability. Any other motion may be that of a
    state that the model lacks, and a linear model does not say whether that state decays.

    Args:
        model: what it says of itself.
        delayed: matrices of the delayed states, (tau, n, n).
        history: states before slot 0, newest first, (h, n).
        track: its run.
        other: its run with another seed.
        names: name and unit of every state, and of every output.
    """
    n = len(model.A)
    if track.states.shape[1] == n:
        residuals = [(_residual(model, delayed, history, t), t.outputs - t.states @ model.C.T) for t in (track, other)]
        motions = [
            kind_of(residual, second, sizes, signals)
            for residual, second, sizes, signals in zip(residuals[0], residuals[1], (track.states, track.outputs), names)
        ]
    else:
        if len(delayed):
            return FreeMotion("not compared")
        residual, second = (_unexplained(model, t.outputs) for t in (track, other))
        motions = [kind_of(residual, second, track.outputs, names[1])]
    order: tuple[Free, ...] = ("moves", "noise", "constant", "none")
    return min(motions, key=lambda motion: order.index(motion.kind))


def _residual(model: LoopModel, delayed: Array, history: Array, track: Track) -> Array:
    """x(k+1) - A x(k) - A_1 x(k-1) - ..., (k, n)."""
    past = np.zeros((len(delayed), len(model.A)))
    past[: len(history)] = history[: len(delayed)]
    x = np.vstack([past[::-1], track.states])
    first = len(delayed)
    left = x[first + 1 :] - x[first:-1] @ model.A.T
    for i, matrix in enumerate(delayed, start=1):
        left -= x[first - i : -1 - i] @ matrix.T
    return np.asarray(left)


def _unexplained(model: LoopModel, outputs: Array) -> Array:
    """The part of the outputs that no first state and no constant force of the model explains, (k, p)."""
    n, powers, forced = len(model.A), [np.eye(len(model.A))], [np.zeros_like(model.A)]
    for _ in range(len(outputs) - 1):
        forced.append(model.A @ forced[-1] + np.eye(n))
        powers.append(model.A @ powers[-1])
    table = np.concatenate([np.hstack([model.C @ a, model.C @ b]) for a, b in zip(powers, forced)])
    width = np.abs(table).max(axis=0)
    table = table / np.where(width > 0.0, width, 1.0)
    flat = outputs.reshape(-1)
    return np.asarray((flat - table @ np.linalg.lstsq(table, flat, rcond=None)[0]).reshape(outputs.shape))


