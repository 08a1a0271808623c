"""Controllers that render a wall over a network: through a coupler, and by model following. They need numpy at most.

Reference: Chapter 6, Figures 6.3, 6.4 and (6.7); the send-all packet: (7.9)-(7.13).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from design.controllers.contract import LoopModel, Rows, Selection
from design.controllers.exact_products import dot, product
from design.controllers.rendered_wall import Array, Coupler
from design.controllers.wall import Contact, Wall
from design.errors import FieldError


@dataclass(frozen=True, slots=True, kw_only=True)
class VirtualWall:
    """A wall and the taps of its coupler, as they run.

    From a delayed position to a force, through contact and coupler:

        x_v(k) = x(k - tau) - (C f)(k),     u(k) = -f(k - d)

    Where the ends equalise their delays, the wall takes x(k - tau_max) in every slot, whatever the network did, and the packet
    carries a row for every age d, so that the force of slot g is felt in slot g + d_max and in no other. The loop then has one
    delay, tau_max + d_max, and the condition for a coupler over one delay holds.

    The plant measures position, y and z in m, and takes one force in N.

    Args:
        wall: materials, where they lie, what happens where they change.
        coupler: taps in m/N.
        equalise: take the position of tau_max samples ago and let the force be felt d_max samples later, always.
        samples: samples in one sensor packet; to equalise as many are needed as the delay can vary by, and one.
    """

    kind: ClassVar[str] = "virtual-wall-taps"

    wall: Wall = field(default_factory=Wall)
    coupler: Coupler
    equalise: bool = False
    samples: int = 1

    def __post_init__(self) -> None:
        if self.samples < 1:
            raise FieldError("samples", f"{self.samples}, expected at least 1")

    def start(self, model: LoopModel) -> VirtualWallRun:
        """Return the wall, ready for slot 0.

        Raises:
            ValueError: the plant is no device at a wall.
        """
        m, p = model.B.shape[1], model.C.shape[0]
        if (m, p) != (1, 3):
            wanted = "one force and a measured position, y and z (0 where it has none)"
            raise FieldError("wall", f"needs {wanted}; inputs of the plant: {m}, outputs: {p}")
        direct = self.coupler.taps_m_per_n[0] + self.coupler.integrator_m_per_n
        for i, each in enumerate(self.wall.materials):
            steep = each.stiffness_n_per_m + each.damping_n_s_per_m / model.period_s
            if 1.0 + (direct - each.spared_m_per_n) * steep <= 0.0:
                name, value = "coupler.taps_m_per_n[0]", self.coupler.taps_m_per_n[0]
                if each.spared_m_per_n:
                    name, value = f"wall.materials[{i}].spared_m_per_n", each.spared_m_per_n
                raise FieldError(
                    name, f"{value!r}; the force of wall.materials[{i}] has no one value: the first tap less what is spared is "
                    f"{direct - each.spared_m_per_n:.6g} m/N, expected above {-1.0 / steep:.6g} m/N",
                )
        return VirtualWallRun(self, model)


class VirtualWallRun:
    """The wall while it runs."""

    def __init__(self, law: VirtualWall, model: LoopModel) -> None:
        self.selection: Selection = "applied" if law.equalise else "constant"
        self.contact = Contact(law.wall, model.period_s, law.wall.material)
        self._law, self._tau_max, self._d_max = law, model.tau_max, model.d_max
        self._equalise = law.equalise
        taps = law.coupler.taps_m_per_n
        self._integrator = law.coupler.integrator_m_per_n
        self._find = None if law.wall.pattern is None else law.wall.pattern.finder()
        self._direct = taps[0] + law.coupler.integrator_m_per_n
        self._taps = taps[1:]
        kept = max(len(taps) - 1, model.d_max + 1)
        self._forces: deque[float] = deque([0.0] * kept, maxlen=kept)  # newest first
        self._sum = 0.0  # of all forces, for the integrator
        self._rng = np.random.default_rng(law.wall.chain_seed) if law.wall.chain else None
        self._rows = [list(np.cumsum(row)) for row in law.wall.chain or ()]
        self._material, self._drawn = law.wall.material, 0
        self._seen: dict[int, Sequence[float]] = {}
        self._k: int | None = None
        self._last: Sequence[float] | None = None

    def rows(self, k: int, tau: int, y: Sequence[float], r: Sequence[float]) -> Rows:
        """Return the force as one row, or one row for every age at which it may be applied.

        Args:
            k: slot.
            tau: age of the newest sample in slots.
            y: position, y, z of the newest sample in m, then of those before it.
            r: reference, of no use to a wall.
        """
        first = k if self._k is None else self._k + 1
        if not self._equalise:
            for slot in range(first, k + 1):  # a slot without an answer still passes
                self._press(slot, y)
            self._k = k
            return ((-self._forces[0] or 0.0,),)
        for i in range(self._law.samples):
            if k - tau - i >= 0:
                self._seen.setdefault(k - tau - i, tuple(y[3 * i : 3 * i + 3]))
        for slot in range(first, k + 1):
            at = slot - self._tau_max
            sample = self._seen.pop(at, self._last)  # what was lost is held
            self._last = sample
            if sample is not None:
                self._press(slot, sample)
            else:
                self._forces.appendleft(0.0)
        self._k = k
        return tuple((-self._forces[self._d_max - d] or 0.0,) for d in range(self._d_max + 1))

    def _press(self, slot: int, sample: Sequence[float]) -> None:
        contact, forces, find = self.contact, self._forces, self._find
        material = self._drawn_until(slot) if find is None else find(sample[1], sample[2])
        if material != contact.material:
            contact.change(material)
        past = self._integrator * self._sum
        for tap, force in zip(self._taps, forces):
            past += tap * force
        force = contact.press(sample[0] - past, self._direct)
        self._sum += force
        forces.appendleft(force)

    def _drawn_until(self, slot: int) -> int:
        while self._rng is not None and self._drawn < slot:
            row = self._rows[self._material]
            u = float(self._rng.random())
            self._material = next((j for j, total in enumerate(row) if u < total), len(row) - 1)
            self._drawn += 1
        return self._material


Matrix = tuple[tuple[float, ...], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelFollowing:
    """The gains of a wall that is rendered by model following, as they run.

    The device is to move as if it stood at the wall without a network.

    A Kalman filter estimates place, speed and the force of the hand from the delayed position; a target model of each material,

        m x_m'' = h - (b + B_i) x_m' - K_i x_m,

    moves under that force; and u = -F_i (x, v, h, u(k-1) .. u(k-n2), x_m, v_m) draws the device after it. It knows one hand, that
    of its model: another hand may make it unstable, and the certificate says so.

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
        late, back = len(self.filter_gain) - 3, {len(row) - 5 for row in self.feedback}
        short = late <= model.tau_max and len(back) == 1 and max(back) <= model.d_max
        if not short or len(self.feedback) != len(self.wall.materials):
            raise FieldError("feedback", f"made for other delays or materials, expected {model.tau_max} + {model.d_max} at most")
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
