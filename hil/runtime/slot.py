"""The order of a slot, written once: virtual time, real time, warm-up, replay and tests all run it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

from hil.runtime.nodes.rig import Rig

OnFrame = Callable[[bytes], bool]
"""Takes one frame that came back; true when it answers the current slot."""


class Exchange(Protocol):
    """How the question of a slot reaches a controller, and how its answer comes back."""

    def ask(self, t_ns: int, frames: Sequence[bytes]) -> None:
        """Put the sensor frames of the slot on their way.

        Args:
            t_ns: nominal time of the slot, ns.
            frames: sensor frames, in order; the last one closes the slot.
        """

    def answer(self, t_ns: int, on_frame: OnFrame) -> None:
        """Hand over what comes back, until one frame answers the slot or no more may come.

        Args:
            t_ns: nominal time of the slot, ns.
            on_frame: takes one frame.
        """


class Slot:
    """One slot of a rig: sense, ask, record, receive, actuate, commit.

    Args:
        rig: the emulated hardware and network.
        exchange: the way to the controller and back.
        commit: called once the slot is complete: its records may leave; by default none is kept.
        stopped: whether the run was ended from outside; a slot that is cut off is not completed.
    """

    def __init__(
        self,
        rig: Rig,
        exchange: Exchange,
        commit: Callable[[], None] = lambda: None,
        stopped: Callable[[], bool] = lambda: False,
    ) -> None:
        self._rig, self._exchange, self._commit, self._stopped = rig, exchange, commit, stopped

    def run(self, t_ns: int) -> None:
        """Run the slot that begins at ``t_ns``.

        Args:
            t_ns: nominal time, ns; a multiple of the period.
        """
        rig, exchange = self._rig, self._exchange
        frames = rig.sense(t_ns)  # the plant reaches t_k and is measured; the network says what arrives
        exchange.ask(t_ns, frames)
        rig.record(t_ns, frames)  # while the controller computes
        exchange.answer(t_ns, rig.on_frame)
        if self._stopped():
            return
        rig.actuate(t_ns)
        self._commit()
