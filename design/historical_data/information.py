r"""Which past samples the controller has, by phase of the schedule: the zero-element constraints (5.8), in general.

A schedule of L phases names the node that sends in each. In a slot of phase i the packet sent e slots ago (phase i - e) has
arrived if e >= delay, and it holds the m newest samples that its node had then. So x_l(k - j) is known iff

.. math:: \exists\, e \ge \text{delay}:\quad \text{order}[(i - e) \bmod L] = \text{node}(l), \qquad 0 \le j - e \le m - 1 .

DEVIATION: Remark 5.2 sets K(., 0) = 0 for a delay of one sample. The whole mask shifts instead: what was sent one slot later is
known one slot later.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from design.errors import FieldError

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True, kw_only=True)
class Information:
    """Who measures what, who sends when, and how much of the past a packet carries.

    Args:
        nodes: per state the number of the node that measures it, counted from 0.
        order: which node sends in phase 0, 1, ...; (0, 1, ..., n - 1) is round robin (5.2).
        buffer: m, samples of each state in a packet, the newest first.
        memory: tau, the oldest sample x(k - tau) that the controller uses.
        delay: sensor-to-controller delay, samples.

    Raises:
        ValueError: a number that does not fit; the message begins with its name.
    """

    nodes: tuple[int, ...]
    order: tuple[int, ...]
    buffer: int
    memory: int
    delay: int = 0

    def __post_init__(self) -> None:
        if not self.nodes or min(self.nodes) < 0:
            raise FieldError("nodes", f"{list(self.nodes)}, expected a node from 0 for every state")
        strangers = sorted(set(self.order) - set(self.nodes))
        if not self.order or strangers:
            raise FieldError("order", f"{list(self.order)}, expected nodes that measure something: {sorted(set(self.nodes))}")
        if not 1 <= self.buffer <= self.memory + 1:
            raise FieldError("buffer", f"{self.buffer} samples, expected 1 to memory + 1 = {self.memory + 1}")
        if self.memory < 0:
            raise FieldError("memory", f"{self.memory}, expected 0 or more")
        if not 0 <= self.delay <= self.memory:
            raise FieldError("delay", f"{self.delay} samples, expected 0 to the memory, {self.memory}")

    @property
    def phases(self) -> int:
        """L, the length of the schedule."""
        return len(self.order)

    def newest(self, phase: int, node: int) -> list[int]:
        """Return the ages of the packets of a node that have arrived in a phase, newest first, as far as the memory reaches."""
        ages = range(self.delay, self.memory + 1)
        return [e for e in ages if self.order[(phase - e) % self.phases] == node]

    def mask(self) -> Mask:
        """Return which gains may differ from zero, (phases, memory + 1, states): [i, j, l] stands for x_l(k - j).

        >>> print(Information(nodes=(0, 1, 2, 3), order=(0, 1, 2, 3), buffer=3, memory=5).mask()[2].astype(int))
        [[0 0 1 0]
         [0 1 1 0]
         [1 1 1 0]
         [1 1 0 1]
         [1 0 1 1]
         [0 1 1 1]]
        """
        known = np.zeros((self.phases, self.memory + 1, len(self.nodes)), dtype=bool)
        for i in range(self.phases):
            for state, node in enumerate(self.nodes):
                for e in self.newest(i, node):
                    known[i, e : e + self.buffer, state] = True
        return known


def round_robin(states: int, *, buffer: int, memory: int | None = None, delay: int = 0) -> Information:
    """Return the chapter's arrangement: sensor l measures x_l, one after the other (5.2).

    Args:
        states: n.
        buffer: m.
        memory: tau; default n + m - 2 + delay, the oldest sample of the first full cycle.
        delay: sensor-to-controller delay, samples.
    """
    every = tuple(range(states))
    reach = states + buffer - 2 + delay if memory is None else memory
    return Information(nodes=every, order=every, buffer=buffer, memory=reach, delay=delay)
