"""The rig process: the emulated hardware in real time, and the emulated network on both sides of it.

Started as ``python -m hil.runtime.real.rig_process`` with a pickled :class:`Job` on standard input. Records leave through a
non-blocking pipe; nothing here writes a file.
"""

from __future__ import annotations

import math
import pickle
import signal
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from types import FrameType

from hil.compose.loop import Loop
from hil.log.write.pipe import PipeSink
from hil.log.write.sinks import MemorySink
from hil.runtime.nodes.controller_node import HELLO
from hil.runtime.nodes.rig import Rig
from hil.runtime.real.scheduling import die_with_parent, go_real_time
from hil.runtime.slot import Hear, Slot
from hil.runtime.time.clock import RealClock, monotonic_ns
from hil.runtime.time.kernel import Kernel
from transport.links.link import Link, TransportError, open_link
from transport.packets import EMPTY, SELECTIONS, ControlPacket, SensorPacket, decode, encode_control, encode_sensor

HELLO_S = 0.05
REHEARSALS = 20
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


def await_controller(link: Link, timeout_s: float, stopped: Callable[[], bool]) -> bool:
    """Ask "is anybody there" until a controller answers, then empty the link; False if nobody did.

    A few more questions follow, so that slot 0 finds no cold link and no sleeping thread on its way.
    """
    hello = encode_sensor(SensorPacket(HELLO, EMPTY, 0, ()))
    limit = monotonic_ns() + round(timeout_s * 1e9)
    while not stopped() and monotonic_ns() < limit:
        link.send(hello)
        data = link.receive(HELLO_S)
        packet = decode(data) if data is not None else None
        if isinstance(packet, ControlPacket) and packet.seq == HELLO:
            while link.receive(2 * HELLO_S) is not None:  # answers to earlier questions
                pass
            for _ in range(REHEARSALS):
                link.send(hello)
                if link.receive(HELLO_S) is None:
                    break
            return True
    return False


class RealLoop:
    """The slots of a rig on a real link, timed."""

    def __init__(self, job: Job, link: Link, sink: PipeSink) -> None:
        e = job.loop.experiment
        channels = job.loop.channels()
        self.clock = RealClock(monotonic_ns() + SETTLE_NS)
        self.kernel = Kernel(self.clock)
        self.rig = Rig(job.loop, job.seed, sink, channels, self.kernel.stop)
        self.overruns = 0
        self._link, self._sink = link, sink
        self._period_ns = e.period_ns
        self._deadline_ns = round(e.timing.deadline * e.period_ns)
        self._put, self._pack = sink.channel("/timing/tick"), channels["/timing/tick"].schema.pack
        self._woken_ns = self._sent_ns = self._late = 0
        self._round_trip_us = math.nan
        self._slot = Slot(self.rig, self, self._commit, lambda: self.kernel.stopped)
        self.kernel.every(e.period_ns, e.ticks, self._run)

    def _run(self, t_ns: int) -> None:
        self._woken_ns = self.clock.now()
        self._late = self.rig.late
        self._slot.run(t_ns)

    def ask(self, t_ns: int, frames: Sequence[bytes]) -> None:
        """Put the question on the link."""
        for frame in frames:
            self._sent_ns = self.clock.now()
            self._link.send(frame)

    def answer(self, t_ns: int, hear: Hear) -> None:
        """Wait for the answer until the deadline, which runs from the moment the question left: a rig that woke up
        late does not make its controller late."""
        deadline = max(t_ns, self._sent_ns) + self._deadline_ns
        self._waited_from_ns = now = self.clock.now()
        self._round_trip_us = math.nan
        while True:
            data = self._link.receive(max(deadline - now, 0) / 1e9)
            now = self.clock.now()
            if data is None:
                if now >= deadline or self.kernel.stopped:
                    break
                continue
            if hear(data):
                self._round_trip_us = (now - self._sent_ns) / 1e3
                break
        self._waited_ns = now - self._waited_from_ns

    def _commit(self, t_ns: int) -> None:
        rig, end = self.rig, self.clock.now()
        overrun = end > t_ns + self._period_ns
        self.overruns += overrun
        if self._put is not None:
            lateness_us = (self._woken_ns - t_ns) / 1e3
            work_us = (end - self._woken_ns - self._waited_ns) / 1e3
            self._put(
                t_ns, self._pack(lateness_us, self._round_trip_us, work_us, rig.k, rig.late - self._late, overrun)
            )
        self._sink.commit()


class Rehearsal:
    """A link without a link: every question is answered with zeros, so that no line of a controller runs in this process."""

    def __init__(self, loop: Loop) -> None:
        self._period_ns = loop.experiment.period_ns
        self._selection = SELECTIONS.index(loop.selection)
        self._rows = ((0.0,) * len(loop.experiment.plant.inputs),) * loop.rows

    def ask(self, t_ns: int, frames: Sequence[bytes]) -> None:
        """Let the frames go."""

    def answer(self, t_ns: int, hear: Hear) -> None:
        """Answer with zeros."""
        hear(encode_control(ControlPacket(t_ns // self._period_ns, 0, 0, 0, self._selection, self._rows)))


def warm_up(loop: Loop) -> None:
    """Run a rig through a few slots without a link, so that slot 0 does not pay for what is done once (tables, first calls)."""
    e = loop.experiment
    rig = Rig(loop, 0, MemorySink(loop.channels()), loop.channels(), lambda: None)
    slot = Slot(rig, Rehearsal(loop))
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
    scheduler = go_real_time(timing.priority, 0 if timing.affinity == "pinned" else None, timing.idle == "awake")
    with open_link(job.uri, "rig") as link:
        warm_up(job.loop)
        if not await_controller(link, job.hello_timeout_s, lambda: stopped):
            sink.close()
            raise SystemExit(NOBODY)
        sink.event(0, "started", f"rig started: {scheduler}", scheduler=scheduler)
        sink.commit()
        real = RealLoop(job, link, sink)
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
