"""A plant of your own. Its fields are the keys of the table [plant] of an experiment."""

from dataclasses import dataclass
from typing import ClassVar

from plants import LinearRun, Signal, StateSpace


@dataclass(frozen=True, kw_only=True)
class Mine:
    """A mass with friction: v' = -damping v + gain u.

    Args:
        damping: rate at which the speed decays, 1/s.
        gain: acceleration of a unit of force, m/s² per N.
    """

    damping: float = 0.5
    gain: float = 2.0
    inputs: ClassVar = (Signal("force", "N"),)
    outputs: ClassVar = (Signal("speed", "m/s"),)
    states: ClassVar = (Signal("speed", "m/s"),)

    def model(self):  # x' = A x + B u, y = C x: what a design may know; `hil` compares it with what runs
        return StateSpace(A=[[-self.damping]], B=[[self.gain]], C=[[1.0]])

    def start(self, rng):  # what runs: advance(dt_ns, u, w), measure(), state, applied
        return LinearRun(self.model(), (0.0,))
