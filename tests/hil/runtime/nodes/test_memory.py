"""A rig that runs for days needs no more memory than one that runs for a minute."""

from __future__ import annotations

import tracemalloc

import pytest

from hil.compose.loop import compose
from hil.experiment import load_experiment
from hil.log.topics import channels_of
from hil.log.write.sinks import MemorySink
from hil.runtime.nodes.controller_node import ControlNode
from hil.runtime.nodes.rig import Rig
from hil.runtime.nodes.wire import session_wire
from hil.runtime.slot import Slot


@pytest.mark.parametrize("name", ["dc-motor-1khz", "dc-motor-packets"])
def test_no_node_of_a_rig_grows_with_its_slots(name: str) -> None:
    loop = compose(load_experiment(name))
    rig = Rig(loop, 0, MemorySink(channels_of(loop), []), channels_of(loop), lambda: None, session_wire(b"k" * 16))
    node = ControlNode(loop)

    class Here:
        def ask(self, t_ns: int, frames: list[bytes]) -> None:
            self.frames = frames

        def answer(self, t_ns: int, on_frame) -> None:  # type: ignore[no-untyped-def]
            for data in map(node.on_frame, self.frames):
                if data is not None:
                    on_frame(data)

    slot = Slot(rig, Here())  # type: ignore[arg-type]

    def run(first: int, last: int) -> None:
        for k in range(first, last):
            slot.run(k * loop.experiment.period_ns)

    run(0, 1000)
    tracemalloc.start()
    try:
        run(1000, 3000)
        before, _ = tracemalloc.get_traced_memory()  # what is replaced from now on was itself traced
        run(3000, 4250)
        after, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert after - before < 5_000  # a list of one number a slot has 10,000 bytes more
