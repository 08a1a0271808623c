"""The virtual wall in the loop: from a delayed position to a force, through contact and coupler. It needs numpy at most.

    x_v(k) = x(k - tau) - (C f)(k),     u(k) = -f(k - d)

Where the ends equalise their delays, the wall takes x(k - tau_max) in every slot, whatever the network did, and the packet
carries a row for every age d, so that the force of slot g is felt in slot g + d_max and in no other. The loop then has one delay,
tau_max + d_max, and the condition for a coupler over one delay holds.

Reference: Chapter 6, Figures 6.3, 6.4; the send-all packet: (7.9)-(7.13).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from design.controllers.contract import LoopModel, Rows, Selection
from design.controllers.coupler import Coupler
from design.controllers.wall import Contact, Wall
from design.errors import FieldError


@dataclass(frozen=True, slots=True, kw_only=True)
class VirtualWall:
    """A wall and the taps of its coupler, as they run.

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
            raise FieldError("wall", f"needs one force and a measured position, y and z; the plant has {m} inputs, {p} outputs")
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
