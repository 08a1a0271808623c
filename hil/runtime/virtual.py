"""Virtual time: rig and controller in one process on a clock that jumps; bit-reproducible."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from hil.compose.loop import Loop
from hil.log.topics import channels_of
from hil.log.write.sinks import Sink
from hil.runtime.nodes.controller_node import ControlNode
from hil.runtime.nodes.rig import Rig
from hil.runtime.slot import OnFrame, Slot
from hil.runtime.time.clock import VirtualClock
from hil.runtime.time.kernel import Kernel


class DirectExchange:
    """The controller node in the rig's own process: it answers at once.

    Args:
        node: answers the sensor frames.
    """

    def __init__(self, node: ControlNode) -> None:
        self._node = node
        self._frames: Sequence[bytes] = ()

    def ask(self, t_ns: int, frames: Sequence[bytes]) -> None:
        """Keep the frames for :meth:`answer`."""
        self._frames = frames

    def answer(self, t_ns: int, on_frame: OnFrame) -> None:
        """Let the node take every frame, and hand over what it answers."""
        for frame in self._frames:
            answer = self._node.on_frame(frame)
            if answer is not None:
                on_frame(answer)


def run_virtual(
    loop: Loop, seed: int, sink: Sink, *, stoppable: Callable[[Callable[[], None]], None] = lambda stop: None,
    failed: Callable[[BaseException], bool] = lambda error: False,
) -> Rig:  # fmt: skip
    """Run a loop from slot 0 to its end, or until safety ends it; return the rig with its counters.

    Args:
        loop: the composed experiment.
        seed: seed of the run (the loop's own seed is not read).
        sink: takes the records.
        stoppable: given, before the first slot, a function that ends the run; a signal handler may call it.
        failed: asked of whatever the run raises: whether the run ends in order with it.
    """
    e = loop.experiment
    kernel = Kernel(VirtualClock())
    stoppable(kernel.stop)
    rig = Rig(loop, seed, sink, channels_of(loop), kernel.stop)
    node = ControlNode(loop)
    slot = Slot(rig, DirectExchange(node), sink.commit, lambda: kernel.stopped)
    kernel.every(e.period_ns, e.slots, slot.run)
    try:
        kernel.run()
        rig.compare(node.departed)
    except BaseException as error:
        if not failed(error):
            raise
    return rig
