"""Virtual time: rig and controller in one process on a clock that jumps; bit-reproducible.

`simulate` and its like keep the records in memory: for sweeps, for theory beside what ran, for rehearsals and tests.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import msgspec

from hil.errors import HilError
from hil.log.run import Run
from hil.log.topics import channels_of
from hil.log.write import MemorySink, Sink
from hil.rig.loop import Loop
from hil.runtime.clock import Clock, Kernel
from hil.runtime.nodes import failure_of
from hil.runtime.nodes.controller_node import ControlNode
from hil.runtime.nodes.rig import Rig
from hil.runtime.slot import OnFrame, Slot
from transport.draws import REASONS
from transport.packets import SELECTIONS

if TYPE_CHECKING:
    from hil.runtime.changes import Changes


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


def _changing(
    slot: Slot, rig: Rig, node: ControlNode, sink: Sink, changes: Changes, period_ns: int, stop: Callable[[], None]
) -> Callable[[int], None]:  # fmt: skip
    """Return what runs a slot behind the changes that act from it on."""
    from hil.runtime.changes import log_change, take

    def run(t_ns: int) -> None:
        k = t_ns // period_ns
        for change in changes(k):
            take(change, rig, node)
            log_change(sink, change, t_ns, k)
            if change.loop is None:
                return stop()
        slot.run(t_ns)
        return None

    return run


def run_virtual(
    loop: Loop, seed: int, sink: Sink, *, stoppable: Callable[[Callable[[], None]], None] = lambda stop: None,
    failed: Callable[[BaseException], bool] = lambda error: False, clock: Clock | None = None, changes: Changes | None = None,
) -> Rig:  # fmt: skip
    """Run a loop from slot 0 to its end, or until safety ends it; return the rig with its counters.

    Args:
        loop: the composed experiment.
        seed: seed of the run (the loop's own seed is not read).
        sink: takes the records.
        stoppable: given, before the first slot, a function that ends the run; a signal handler may call it.
        failed: asked of whatever the run raises: whether the run ends in order with it.
        clock: paces the run; by default it does not wait.
        changes: of the experiment while it runs; None for none.

    Raises:
        HilError: a part of the user's own, or a plant, has failed.
    """
    e = loop.experiment
    kernel = Kernel(clock)
    stoppable(kernel.stop)
    rig = Rig(loop, seed, sink, channels_of(loop), kernel.stop, changing=changes is not None)
    node = ControlNode(loop)
    slot = Slot(rig, DirectExchange(node), sink.commit, lambda: kernel.stopped)
    run = slot.run if changes is None else _changing(slot, rig, node, sink, changes, e.period_ns, kernel.stop)
    try:
        try:
            kernel.run(e.period_ns, e.slots, run)
        except Exception as error:
            if not failed(error):
                raise
        rig.compare(node.departed)  # of a run that a part of it ended, too
    except BaseException as error:
        if not failed(error):
            failure = failure_of(loop, error)
            if failure is None:
                raise
            raise HilError(": ".join(failure)) from error
    return rig


def simulate(loop: Loop, seed: int, topics: Collection[str] | None = None) -> Run:
    """Run a loop in virtual time without a file, keeping only some topics."""
    sink = MemorySink(channels_of(loop), topics)
    rig = run_virtual(loop, seed, sink)
    return Run.from_memory(sink, summary=dict(rig.outcome()))


def simulate_as_logged(loop: Loop, seed: int) -> Run:
    """Run a loop in virtual time without a file; return what its log would say."""
    sink = MemorySink(channels_of(loop))
    rig = run_virtual(loop, seed, sink)
    return _as_logged(sink, loop, seed, summary=dict(rig.outcome()))


def rehearsal(loop: Loop) -> Run:
    """Return the first 20 slots of a run, which ends in order where a plug-in fails."""
    experiment = loop.experiment
    short = msgspec.structs.replace(experiment, duration=min(20, experiment.slots) * experiment.period)
    sink = MemorySink(channels_of(loop))
    run_virtual(replace(loop, experiment=short), 0, sink, failed=lambda error: not isinstance(error, KeyboardInterrupt))
    return _as_logged(sink, loop, 0)


def _as_logged(sink: MemorySink, loop: Loop, seed: int, **about: Any) -> Run:
    experiment = loop.experiment
    return Run.from_memory(
        sink,
        metadata={"experiment": experiment.name, "seed": str(seed), "clock": "virtual", "link": "memory:"} | experiment.origins(),
        codes={"reason": list(REASONS), "selection": list(SELECTIONS)},
        experiment_text=experiment.text,
        resolved=experiment.resolved(),
        certificate=loop.certificate or {},
        **about,
    )
