"""What a run is compared with while it runs: the model of its plant, slot by slot, and the table of its controller.

The test before a run, `hil.certify.conformance`, ends after some slots; who lies later, beyond the tested inputs or at some
state is seen here alone. Both say by the same tolerances what is equal, and what kind a motion is that no model explains.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from design.controllers import MultiSampleController, RunningController

if TYPE_CHECKING:
    from design.controllers import Controller

Array = NDArray[np.float64]
Running = RunningController | MultiSampleController

EQUAL = 1e-6
"""Share of the motion by which an honest plant may miss its model: rounding, and a fine integrator's error."""
CANCELS = 1e-11
"""What the difference of two runs loses by rounding, as a share of their states."""
LARGEST = 1e60
RUN_AGAIN = 20_000
"""Slots with loads or noise that are run once more beside a run's record: every one costs as much as the plant itself."""


class OneStep(Struct, frozen=True, kw_only=True):
    """What the record of a plant fulfils in every slot if it moves by its model: e(k) = sum_i taps[i] z(k - i) = 0.

    z(k) = (x, y, u + w) in slot k. A load or noise that nothing else moves is left in e.

    Args:
        taps: (h + 1, q, width of z).
        names: name and unit of every row of e.
        stated: what the plant says that pushes it from within.
    """

    taps: Array
    names: tuple[tuple[str, str], ...]
    stated: tuple[str, ...] = ()


class JumpStep(Struct, frozen=True, kw_only=True):
    """What holds in a slot without a jump: |x(k+1) - F_i x(k) - G_i v| <= W_i (|x(k)|, |v|), entry by entry; v = u + w.

    Args:
        flows: [F_i G_i], (N, n, n + m).
        bands: W_i, (N, n, n + m); zero where the matrices are certain.
        seen: whether the mode that is measured is the true one; else any of them may be it.
        unseen: mean number of jumps in a slot whose two ends show the same mode.
        names: name and unit of every state.
    """

    flows: Array
    bands: Array
    seen: bool
    unseen: float
    names: tuple[tuple[str, str], ...]


class Watched(Struct, frozen=True, kw_only=True):
    """What is compared in a run.

    Args:
        plant: of the plant, None where nothing is.
        controller: what the controller says that it is, None where nothing is.
        claimed: whether a certificate rests on it.
        laws: which network laws are the user's own and state a chain, as places among those of the rig.
    """

    plant: OneStep | JumpStep | None
    controller: Controller | None
    claimed: bool
    laws: tuple[int, ...] = ()


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


def kind_of(mine: Array, its: Array, sizes: Array, signals: list[tuple[str, str]]) -> FreeMotion:
    """Return what kind of motion is left, of a run and of another one of the same seed.

    Args:
        mine, its: what is left in every slot of both runs, (slots, q).
        sizes: of the states, whose rounding is no motion.
        signals: name and unit of every column.
    """
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


def looks_back(running: Running) -> int | None:
    """Return the age in slots of the oldest sample that a running controller is handed; None where it gets the newest alone."""
    return running.memory if isinstance(running, MultiSampleController) else None


def handed(running: Running) -> str:
    """Return in words which samples a running controller is handed."""
    memory = looks_back(running)
    return "takes the newest sample alone" if memory is None else f"takes every sample of the last {memory + 1} slots"
