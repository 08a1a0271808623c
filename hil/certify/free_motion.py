"""What a plant does without any input, beside what its model foretells from the state in which it starts.

A load moves the point of rest and noise scatters around it: neither touches stability. A motion of its own that is neither may
be a state that the model does not know, and nothing in a linear model says whether that state dies out.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from design.controllers import LoopModel
from hil.certify.motion_test import Array, Track

Free = Literal["none", "constant", "noise", "moves", "not compared"]
ROUNDING = 1e-9
STEPS = 4
"""Instants at which a load may set in or end; in a slot of its own each time."""
GROWTH = 3.0
"""Noise of one deviation whose last third is larger than its first by this factor: one in 1e20 runs of 300 slots."""


class FreeMotion(NamedTuple):
    """What is left of a free motion when the model's is taken away: its kind, its size, and the signal's name and unit."""

    kind: Free
    size: float = 0.0
    signal: tuple[str, str] = ("", "")


def free_motion(
    model: LoopModel, delayed: Array, history: Array, track: Track, other: Track, names: tuple[list[tuple[str, str]], ...]
) -> FreeMotion:
    """Return what a plant does beyond its model without inputs.

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
        left = [(_residual(model, delayed, history, t), t.outputs - t.states @ model.C.T) for t in (track, other)]
        found = [
            kind_of(mine, its, sizes, signals)
            for mine, its, sizes, signals in zip(left[0], left[1], (track.states, track.outputs), names)
        ]
    else:
        if len(delayed):
            return FreeMotion("not compared")
        mine, its = (_unexplained(model, t.outputs) for t in (track, other))
        found = [kind_of(mine, its, track.outputs, names[1])]
    order: tuple[Free, ...] = ("moves", "noise", "constant", "none")
    return min(found, key=lambda each: order.index(each.kind))


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
    """What of the outputs no first state and no constant force of the model explains, (k, p)."""
    n, powers, forced = len(model.A), [np.eye(len(model.A))], [np.zeros_like(model.A)]
    for _ in range(len(outputs) - 1):
        forced.append(model.A @ forced[-1] + np.eye(n))
        powers.append(model.A @ powers[-1])
    table = np.concatenate([np.hstack([model.C @ a, model.C @ b]) for a, b in zip(powers, forced)])
    width = np.abs(table).max(axis=0)
    table = table / np.where(width > 0.0, width, 1.0)
    flat = outputs.reshape(-1)
    return np.asarray((flat - table @ np.linalg.lstsq(table, flat, rcond=None)[0]).reshape(outputs.shape))


def kind_of(mine: Array, its: Array, sizes: Array, signals: list[tuple[str, str]]) -> FreeMotion:
    count = min(len(mine), len(its))
    scale = ROUNDING * np.maximum.accumulate(np.abs(sizes)).max(axis=1, keepdims=True)[: len(mine)] + 1e-300
    scale = scale + ROUNDING * np.abs(sizes[0]).max()
    if not (np.abs(mine) > scale).any():
        return FreeMotion("none")
    k, i = np.unravel_index(int(np.abs(mine).argmax()), mine.shape)
    found = (float(abs(mine[k, i])), signals[int(i)])
    third = max(len(mine) // 3, 1)
    if (np.abs(mine[:count] - its[:count]) > scale[:count]).any():
        early, late = (float(np.sqrt((part * part).mean())) for part in (mine[:third], mine[-third:]))
        return FreeMotion("moves" if late > GROWTH * early + float(scale.max()) else "noise", *found)
    changes = int((np.abs(np.diff(mine, axis=0)) > 2.0 * scale[1 : len(mine)]).any(axis=1).sum())
    return FreeMotion("constant" if changes <= STEPS else "moves", *found)
