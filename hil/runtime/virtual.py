"""Virtual time: rig and controller in one process on a clock that jumps; bit-reproducible."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from hil.compose.loop import Loop
from hil.log.write.sinks import Sink
from hil.runtime.nodes.controller_node import ControlNode
from hil.runtime.nodes.rig import Rig
from hil.runtime.time.clock import VirtualClock
from hil.runtime.time.kernel import Kernel, Phase


def run_virtual(
    loop: Loop, seed: int, sink: Sink, *, stoppable: Callable[[Callable[[], None]], None] = lambda stop: None
) -> Rig:
    """Run a loop from slot 0 to its end, or until safety ends it; return the rig with its counters.

    Args:
        loop: the composed experiment.
        seed: seed of the run (the loop's own seed is not read).
        sink: takes the records.
        stoppable: given, before the first slot, a function that ends the run; a signal handler may call it.
    """
    e = loop.experiment
    kernel = Kernel(VirtualClock())
    stoppable(kernel.stop)
    frames: deque[bytes] = deque()
    rig = Rig(loop, seed, sink, loop.channels(), frames.append, kernel.stop)
    node = ControlNode(loop)

    def exchange(t_ns: int) -> None:
        while frames:
            answer = node.hear(frames.popleft())
            if answer is not None:
                rig.hear(answer)

    def actuate(t_ns: int) -> None:
        rig.actuate(t_ns)
        sink.commit()

    kernel.every(e.period_ns, e.ticks, Phase.SENSE, rig.sense)
    kernel.every(e.period_ns, e.ticks, Phase.EXCHANGE, exchange)
    kernel.every(e.period_ns, e.ticks, Phase.ACTUATE, actuate)
    kernel.run()
    return rig
