"""What a process does once before its session begins, so that slot 0 does not pay for it: tables, caches, first calls."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import suppress

from hil.log.topics import channels_of
from hil.log.write.pipe_sink import PipeSink
from hil.log.write.sinks import MemorySink
from hil.rig.loop import Loop
from hil.runtime.nodes.controller_node import ControlNode
from hil.runtime.nodes.rig import Rig
from hil.runtime.nodes.wire import VIRTUAL, Wire
from hil.runtime.slot import OnFrame, Slot
from hil.runtime.time.clock import monotonic_ns
from hil.runtime.virtual import DirectExchange
from transport.packets import SELECTIONS, ControlPacket, encode_control
from transport.wire import echo

SLOTS = 50
MOST_S = 0.5
"""Longest warm-up of a control law, s."""


class WarmUpExchange:
    """A link without a link: every question is answered with zeros, so that no line of a controller runs in this process."""

    def __init__(self, loop: Loop, wire: Wire) -> None:
        self._wire, self._echo = wire, 0
        self._period_ns = loop.experiment.period_ns
        self._selection = SELECTIONS.index(loop.selection)
        self._rows = ((0.0,) * len(loop.experiment.plant.inputs),) * loop.rows

    def ask(self, t_ns: int, frames: Sequence[bytes]) -> None:
        """Keep what an answer has to echo."""
        self._echo = echo(frames) if self._wire is not VIRTUAL else 0

    def answer(self, t_ns: int, on_frame: OnFrame) -> None:
        """Answer with zeros."""
        on_frame(encode_control(ControlPacket(t_ns // self._period_ns, -1, 0, 0, self._selection, self._rows, self._echo)))


class WarmUpRig:
    """A rig that runs through slots without a link; its records go nowhere.

    Args:
        loop: the composed experiment.
        wire: nonces, other ones than those of the session.
        local: the controller will run in this process: it takes part.
    """

    def __init__(self, loop: Loop, wire: Wire, local: bool = False) -> None:
        self._failed = False
        self._k, self._period_ns, channels = 0, loop.experiment.period_ns, channels_of(loop)
        self._sink = PipeSink(os.open(os.devnull, os.O_WRONLY | os.O_CLOEXEC), channels)
        rig = Rig(loop, 0, self._sink, channels, lambda: None, wire)
        exchange = DirectExchange(ControlNode(loop)) if local else WarmUpExchange(loop, wire)
        self._slot = Slot(rig, exchange, self._sink.commit)

    def run(self) -> None:
        """Run the next slot."""
        if self._failed:
            return
        try:
            self._slot.run(self._k * self._period_ns)
        except Exception:  # a part that fails is to fail in the session, where it is reported
            self._failed = True
        self._k += 1

    def warm_up(self) -> WarmUpRig:
        """Run so many slots that every table and cache is filled."""
        for _ in range(SLOTS):
            self.run()
        return self


def warm_up_controller(loop: Loop) -> None:
    """Run a control law of its own through a few slots of a rig, within `MOST_S`.

    Args:
        loop: the composed experiment.
    """
    e, limit = loop.experiment, monotonic_ns() + round(MOST_S * 1e9)
    with suppress(Exception):  # a law that fails is to fail in the session, where it is reported
        rig = Rig(loop, 0, MemorySink(channels_of(loop), ()), channels_of(loop), lambda: None, VIRTUAL)
        slot = Slot(rig, DirectExchange(ControlNode(loop)))
        for k in range(min(e.slots, SLOTS)):
            if monotonic_ns() > limit:
                break
            slot.run(k * e.period_ns)
