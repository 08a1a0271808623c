"""A wall rendered by model following: the device is to move as if it stood at the wall without a network. It needs numpy.

A Kalman filter estimates place, speed and the force of the hand from the delayed position; a target model of each material,

    m x_m'' = h - (b + B_i) x_m' - K_i x_m,

moves under that force; and u = -F_i (x, v, h, u(k-1) .. u(k-n2), x_m, v_m) draws the device after it. It knows one hand, that of
its model: whoever else holds the device may make it unstable, and its certificate says so.

Reference: Chapter 6, (6.7) as a linear-quadratic problem; delays in the state.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from design.controllers.contract import LoopModel, Rows, Selection
from design.controllers.ordered import dot, product
from design.controllers.wall import Wall
from design.errors import FieldError

Array = NDArray[np.float64]
Matrix = tuple[tuple[float, ...], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelFollowing:
    """The gains of a wall that is rendered by model following, as they run.

    Args:
        wall: materials, and where they lie.
        plant: (3, 3) of (x, v, h) over a sample, the force of the hand constant.
        force: (3,) what the motor's force adds over a sample.
        filter_gain: (3 + n1,) Kalman gain of (x, v, h, x(k-1) .. x(k-n1)).
        targets: (N, 2, 3) of (x_m, v_m) from (x_m, v_m, h), one per material.
        feedback: (N, 3 + n2 + 2) the rows F_i.
    """

    kind: ClassVar[str] = "model-following-gains"

    wall: Wall
    plant: Matrix
    force: tuple[float, ...]
    filter_gain: tuple[float, ...]
    targets: tuple[Matrix, ...]
    feedback: Matrix

    def start(self, model: LoopModel) -> ModelFollowingRun:
        """Return the controller, ready for slot 0.

        Raises:
            FieldError: gains for other delays than the loop has.
        """
        sizes = (len(self.filter_gain), {*map(len, self.feedback)})
        wanted = (3 + model.tau_max, {5 + model.d_max})
        if sizes != wanted or len(self.feedback) != len(self.wall.materials):
            raise FieldError("feedback", f"made for other delays or materials, expected those of {model.tau_max} + {model.d_max}")
        return ModelFollowingRun(self)


class ModelFollowingRun:
    """The controller while it runs: state (x, v, h, x-line, u-line, x_m, v_m), the estimate before the sample."""

    selection: Selection = "constant"

    def __init__(self, law: ModelFollowing) -> None:
        self._plant, self._force = law.plant, np.array(law.force)
        self._gain, self._feedback = np.array(law.filter_gain), law.feedback
        self._targets = law.targets
        self._seen, self._line = len(law.filter_gain), len(law.feedback[0]) - 5
        self._find = None if law.wall.pattern is None else law.wall.pattern.finder()
        self._material = law.wall.material
        self._state = np.zeros(self.order)
        self._k = -1

    @property
    def order(self) -> int:
        """Number of states."""
        return self._seen + self._line + 2

    def linear(self, state: Array, place: float, material: int) -> tuple[float, Array]:
        """Return the force u(k) in N and the state of slot k + 1 while in contact.

        Args:
            state: of slot k (order,).
            place: x(k - n1) in m.
            material: index of the material.
        """
        estimate, line, target = self._corrected(state, place)
        force = -self._push(material, estimate, line, target)
        return force, self._after(estimate, line, target, force, self._targets[material])

    def _push(self, material: int, estimate: Array, line: Array, target: Array) -> float:
        return dot(self._feedback[material], [*estimate[:3].tolist(), *line.tolist(), *target.tolist()])

    def _corrected(self, state: Array, place: float) -> tuple[Array, Array, Array]:
        seen = self._seen
        estimate = state[:seen] + self._gain * (place - state[0 if seen == 3 else seen - 1])
        return estimate, state[seen:-2], state[-2:]

    def _after(self, estimate: Array, line: Array, target: Array, force: float, model: Matrix) -> Array:
        felt = float(line[-1]) if line.size else force
        moved = np.array(product(self._plant, estimate[:3].tolist())) + self._force * felt
        places = np.concatenate([estimate[:1], estimate[3:-1]]) if self._seen > 3 else estimate[:0]
        forces = np.concatenate([[force], line[:-1]]) if line.size else line
        return np.concatenate([moved, places, forces, product(model, [*target.tolist(), float(estimate[2])])])

    def rows(self, k: int, tau: int, y: Sequence[float], r: Sequence[float]) -> Rows:
        """Return the force as one row; off the wall there is none. It may pull: what a late push threw back has to be stopped.

        Args:
            k: slot.
            tau: age of the sample in slots.
            y: position, y, z of the sample in m.
            r: reference, of no use to a wall.
        """
        material = self._material if self._find is None else self._find(y[1], y[2])
        force = 0.0
        for _ in range(k - self._k):  # a slot without an answer still passes
            estimate, line, target = self._corrected(self._state, y[0])
            if estimate[0] > 0.0 or target[0] > 0.0:
                force = -self._push(material, estimate, line, target)
            else:
                force, target = 0.0, estimate[:2]
            self._state = self._after(estimate, line, target, force, self._targets[material])
        self._k = k
        return ((force or 0.0,),)
