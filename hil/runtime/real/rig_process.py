"""The rig process: the emulated hardware in real time, and the emulated network on both sides of it.

Started as ``python -m hil.runtime.real.rig_process`` with a pickled :class:`Job` on standard input. Records leave through a
non-blocking pipe; nothing here writes a file.
"""

from __future__ import annotations

import os
import pickle
import signal
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from types import FrameType

from hil.compose.loop import Loop
from hil.experiment.can_frames import about_rig
from hil.log.write.pipe import PipeSink
from hil.log.write.sinks import MemorySink
from hil.runtime.nodes.controller_node import ControlNode
from hil.runtime.nodes.rig import Rig
from hil.runtime.nodes.wire import KEY_BYTES, VERSION_1, Wire, session_wire
from hil.runtime.real.exchange import Greeter, LinkExchange
from hil.runtime.real.local_link import LocalLink
from hil.runtime.real.scheduling import cpu_for, die_with_parent, go_real_time
from hil.runtime.slot import Hear, Slot
from hil.runtime.time.clock import RealClock, monotonic_ns, wall_clock_ns
from hil.runtime.time.kernel import Kernel
from hil.runtime.virtual import DirectExchange
from transport.links.link import Link, Tells, TransportError, wire_version
from transport.links.local import LOCAL
from transport.links.opening import open_link
from transport.packets import SELECTIONS, ControlPacket, encode_control

SETTLE_NS = 5_000_000
NOBODY = 3  # exit status: no controller answered


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """What the rig process needs."""

    loop: Loop
    uri: str
    seed: int
    parent: int
    log_fd: int
    hello_timeout_s: float


class RealLoop:
    """The slots of a rig on a real link, timed."""

    def __init__(self, job: Job, link: Link, sink: PipeSink, wire: Wire) -> None:
        e = job.loop.experiment
        channels = job.loop.channels()
        start_ns = monotonic_ns() + SETTLE_NS
        self.clock = RealClock(start_ns)
        sink.begin(wall_clock_ns(start_ns))
        self.kernel = Kernel(self.clock)
        self.rig = Rig(job.loop, job.seed, sink, channels, self.kernel.stop, wire)
        self.overruns = 0
        self._sink = sink
        self._period_ns = e.period_ns
        self._put, self._pack = sink.channel("/timing/tick"), channels["/timing/tick"].schema.pack
        self._woken_ns = self._late = 0
        deadline_ns = round(e.timing.deadline * e.period_ns)
        self._exchange = LinkExchange(
            link, self.rig, deadline_ns, lambda: self.kernel.stopped, self.clock.now, sink.behind, wire.version == 1
        )
        self._slot = Slot(self.rig, self._exchange, self._commit, lambda: self.kernel.stopped)
        self.kernel.every(e.period_ns, e.ticks, self._run)

    def _run(self, t_ns: int) -> None:
        self._woken_ns = self.clock.now()
        self._late = self.rig.answers.late
        self._slot.run(t_ns)

    def _commit(self, t_ns: int) -> None:
        rig, exchange, end = self.rig, self._exchange, self.clock.now()
        overrun = end > t_ns + self._period_ns
        self.overruns += overrun
        if self._put is not None:
            lateness_us = (self._woken_ns - t_ns) / 1e3
            work_us = (end - self._woken_ns - exchange.waited_ns) / 1e3
            late = rig.answers.late - self._late
            self._put(t_ns, self._pack(lateness_us, exchange.round_trip_us, work_us, rig.k, late, overrun))
        self._sink.commit()


class Rehearsal:
    """A link without a link: every question is answered with zeros, so that no line of a controller runs in this process."""

    def __init__(self, loop: Loop, wire: Wire) -> None:
        self._version = wire.version
        self._period_ns = loop.experiment.period_ns
        self._selection = SELECTIONS.index(loop.selection)
        self._rows = ((0.0,) * len(loop.experiment.plant.inputs),) * loop.rows

    def ask(self, t_ns: int, frames: Sequence[bytes]) -> None:
        """Let the frames go."""

    def answer(self, t_ns: int, hear: Hear) -> None:
        """Answer with zeros."""
        k = t_ns // self._period_ns
        hear(encode_control(ControlPacket(k, 0, 0, 0, self._selection, self._rows, version=self._version)))


def warm_up(loop: Loop, wire: Wire, local: bool = False) -> None:
    """Run a rig through a few slots without a link, so that slot 0 does not pay for what is done once (tables, first calls).

    Args:
        loop: the composed experiment.
        wire: what the session will speak.
        local: the controller will run in this process: it takes part.
    """
    e = loop.experiment
    rig = Rig(loop, 0, MemorySink(loop.channels()), loop.channels(), lambda: None, wire)
    slot = Slot(rig, DirectExchange(ControlNode(loop)) if local else Rehearsal(loop, wire))
    for k in range(min(e.ticks, 50)):
        slot.run(k * e.period_ns)


def main() -> None:
    """Run one job from standard input; exit status `NOBODY` if no controller answered."""
    job: Job = pickle.load(sys.stdin.buffer)
    die_with_parent(job.parent)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    loops: list[RealLoop] = []
    stopped = False

    def stop(_signal: int, _frame: FrameType | None) -> None:
        nonlocal stopped
        stopped = True
        for loop in loops:
            loop.kernel.stop()

    signal.signal(signal.SIGTERM, stop)
    sink = PipeSink(job.log_fd, job.loop.channels())
    timing = job.loop.experiment.timing
    # Before the link is opened, so that the threads of a link inherit the priority.
    scheduler = go_real_time(timing.priority, cpu_for(timing.affinity, "rig", job.uri), timing.idle == "awake")
    wire = VERSION_1 if wire_version(job.uri) == 1 else session_wire(os.urandom(KEY_BYTES))
    local = job.uri == LOCAL
    with LocalLink(ControlNode(job.loop)) if local else open_link(job.uri, "rig") as link:
        warm_up(job.loop, wire, local)
        if isinstance(link, Tells):
            link.tell(about_rig(job.loop.experiment))
        greeting = Greeter(link, job.hello_timeout_s, lambda: stopped, monotonic_ns, wire).greet()
        if not greeting.answered:
            if greeting.foreign:
                sys.stderr.write(f"hil: {greeting.foreign} frames that are no answer came on {job.uri} meanwhile\n")
            sink.close()
            raise SystemExit(NOBODY)
        real = RealLoop(job, link, sink, wire)
        sink.event(0, "started", f"rig started: {scheduler}", scheduler=scheduler)
        sink.commit()
        loops.append(real)
        if not stopped:
            real.kernel.run()
        sink.event(
            max(real.rig.k, 0) * job.loop.experiment.period_ns,
            "outcome",
            "rig ended",
            **real.rig.outcome(),
            scheduler=scheduler,
            overruns=real.overruns,
            link=asdict(link.counters),
        )
        sink.close()


if __name__ == "__main__":
    try:
        main()
    except TransportError as e:
        sys.exit(f"hil: {e}")
