"""What a run is compared with while it runs: the model of its plant, slot by slot, and the table of its controller.

The test at the door ends after some slots; who lies later, beyond the tested inputs or at some state is seen here alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from design.controllers import LoopModel
from hil.certify.jump_step import JumpStep
from hil.plugins.protocols import BeyondModel, HasOwnInputs, HasStateDelays, JumpPlant, Plant

if TYPE_CHECKING:
    from design.controllers import Controller

Array = NDArray[np.float64]
LARGEST_POLYNOMIAL = 12
"""States of a model up to which its outputs alone foretell its outputs: the polynomial of more loses its digits."""


@dataclass(frozen=True, slots=True, kw_only=True)
class OneStep:
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Watched:
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


def one_step(plant: Plant, model: LoopModel) -> OneStep | None:
    """Return what the record of a plant fulfils; None where its record does not say whether it moves by its model.

    Where the states of the model are recorded, x(k) = A x(k-1) + A_1 x(k-2) + ... + B v(k-1) and y(k) = C x(k). Else, by the
    characteristic polynomial a of A (Cayley and Hamilton),

        sum_i a_i y(k-i) = sum_j (sum_{i<j} a_i C A^(j-i-1) B) v(k-j).

    Args:
        plant: what runs.
        model: what it says of itself, at the period of the loop.
    """
    if isinstance(plant, JumpPlant) or (isinstance(plant, BeyondModel) and plant.beyond_model()):
        return None
    A, B, C = model.A, model.B, model.C
    (n, m), p, states = B.shape, len(C), len(plant.states)
    delayed = np.asarray(plant.state_delays()) if isinstance(plant, HasStateDelays) else np.zeros((0, n, n))
    stated = tuple(plant.own_inputs()) if isinstance(plant, HasOwnInputs) else ()
    signals = [(str(s.name), str(s.unit)) for s in (*plant.states, *plant.outputs)]
    if states == n:
        taps = np.zeros((2 + len(delayed), n + p, n + p + m))
        taps[0] = np.eye(n + p, n + p + m)
        taps[0, n:, :n] -= C
        taps[1, :n, :n], taps[1, :n, n + p :] = -A, -B
        for i, matrix in enumerate(delayed, start=2):
            taps[i, :n, :n] = -matrix
        return OneStep(taps=taps, names=tuple(signals), stated=stated)
    if len(delayed) or n > LARGEST_POLYNOMIAL:
        return None
    a = np.real(np.poly(A))
    taps = np.zeros((n + 1, p, states + p + m))
    taps[:, :, states : states + p] = a[:, None, None] * np.eye(p)
    forced = np.zeros((n, m))  # sum_{i<j} a_i A^(j-i-1) B
    for j in range(1, n + 1):
        forced = A @ forced + a[j - 1] * B
        taps[j, :, states + p :] = -C @ forced
    return OneStep(taps=taps, names=tuple(signals[states:]), stated=stated)
