"""The rig process: the emulated hardware in real time, and the emulated network on both sides of it.

A `hil.runtime.real.child.Child` runs it. Records leave through a non-blocking pipe; nothing here writes a file.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from contextlib import suppress
from types import FrameType

from msgspec import Struct, structs

from hil.log.topics import TIMING, channels_of
from hil.log.write import record_to
from hil.log.write.pipe_sink import PipeSink
from hil.rig.loop import Loop
from hil.rig.session_link import SessionLink, about_rig, link_faults
from hil.runtime.changes import ChangeReceiver, log_change, log_late, take
from hil.runtime.clock import Kernel, RealClock, monotonic_ns, wall_clock_ns
from hil.runtime.nodes import KEY_BYTES, Wire, failing, session_wire
from hil.runtime.nodes.controller_node import ControlNode
from hil.runtime.nodes.rig import STATES, Rig
from hil.runtime.real import cpu_for, die_with_parent, go_real_time, leave_real_time
from hil.runtime.real.child import is_open, other_is_open
from hil.runtime.real.ending import ENDED, FAILED, NO_CONTROLLER, STOPPED, useless_frames
from hil.runtime.real.exchange import Handshake, LinkExchange, LocalLink, WarmUpRig
from hil.runtime.slot import Slot
from plants.errors import PlantError
from transport.links import Discoverable, Link, OnBus, TransportError
from transport.links.opening import open_link
from transport.links.zenoh_refusals import standard_output_is_free

PACE_NS = 2_000_000
"""Longest pause between two rehearsals, ns."""

SETTLE_NS = 1_000_000
"""From the end of the rehearsals to slot 0: no longer than between two slots, so that caches and threads stay awake."""
PLAN_NS = 20_000_000
CLOSES_S = 0.5
"""For the link to close, s: a flood keeps zenoh from it for as long as it lasts."""
REHEARSED = 1000
"""Slots that are rehearsed at most."""


class Job(Struct, frozen=True, kw_only=True):
    """What the rig process needs."""

    loop: Loop
    link: SessionLink
    seed: int
    parent: int
    log_fd: int
    hello_timeout_s: float
    changes_fd: int = -1  # where changes come from
    meeting_fd: int = -1  # to the controller process of the session


class RealLoop:
    """The slots of a rig on a real link, timed."""

    def __init__(self, job: Job, link: Link, sink: PipeSink, wire: Wire, node: ControlNode | None = None) -> None:
        e = job.loop.experiment
        self._node, self._changes = node, ChangeReceiver(job.changes_fd)
        channels = channels_of(job.loop, on_can=job.link.on_can)
        self.clock = RealClock(0)  # until the session begins
        self.kernel = Kernel(self.clock)
        first = job.link.logged
        self.rig = Rig(
            job.loop, job.seed, sink, channels, self.kernel.stop, wire, first, lambda t_ns: self._woken_ns, job.changes_fd >= 0
        )  # fmt: skip
        self.overruns = 0
        self._on_bus = link if isinstance(link, OnBus) else None
        self._link_faults, self._seed = link_faults(e, job.loop.rig, job.link), job.seed
        self._sink = sink
        self._period_ns, self._slots = e.period_ns, e.slots
        self._log = record_to(sink, channels[TIMING.name])
        self._t_ns = self._woken_ns = self._late = 0
        deadline_ns = round(e.timing.deadline * e.period_ns)
        self._exchange = LinkExchange(
            link, self.rig.answers, deadline_ns, lambda: self.kernel.stopped, self.clock.now, sink.behind
        )
        self._slot = Slot(self.rig, self._exchange, self._commit, lambda: self.kernel.stopped)

    def pause(self) -> None:
        """Wait as long as between two slots, `PACE_NS` at most."""
        self.clock.wait_until(self.clock.now() + min(self._period_ns, PACE_NS))

    def begin(self) -> None:
        """Begin session time `SETTLE_NS` from now; `PLAN_NS` where the bus of the link is given its faults before."""
        start_ns = monotonic_ns() + (PLAN_NS if self._link_faults else SETTLE_NS)
        if self._link_faults and self._on_bus is not None:
            faults = self._link_faults
            shifted = [each._replace(first_ns=start_ns + each.first_ns, end_ns=start_ns + each.end_ns) for each in faults]
            self._on_bus.disturb(shifted, self._seed)
        self.clock.begin(start_ns)
        self._sink.begin(wall_clock_ns(start_ns))
        self._change(0)

    def run(self) -> None:
        """Run the slots to the end of the session, or until it is stopped."""
        self.kernel.run(self._period_ns, self._slots, self._run)

    def _run(self, t_ns: int) -> None:
        self._t_ns, self._woken_ns = t_ns, self.clock.now()
        self._late = self.rig.answers.late
        self._slot.run(t_ns)

    def _commit(self) -> None:
        t_ns, rig, exchange, end = self._t_ns, self.rig, self._exchange, self.clock.now()
        overrun = end > t_ns + self._period_ns
        self.overruns += overrun
        if self._log is not None:
            lateness_us = (self._woken_ns - t_ns) / 1e3
            work_us = (end - self._woken_ns - exchange.waited_ns) / 1e3
            late = rig.answers.late - self._late
            self._log(t_ns, (lateness_us, exchange.round_trip_us, work_us, rig.k, late, overrun))
        for status in self._on_bus.statuses() if self._on_bus is not None else ():
            message = f"the rig on its link is {STATES[status.state]}: TEC {status.tec}, REC {status.rec}"
            severity = "info" if status.state == "active" else "warning"
            self._sink.event(t_ns, "bus status", message, slot=rig.k, node="rig", severity=severity)
        self._sink.commit()
        self._change(rig.k + 1)

    def _change(self, k: int) -> None:
        """Apply the changes of slot k, in the time that is left before it."""
        for slot, change, acts in self._changes.due(k):
            if not acts:
                log_late(self._sink, change, k * self._period_ns, k, slot)
                continue
            take(change, self.rig, self._node)
            log_change(self._sink, change, k * self._period_ns, k)
            if change.loop is None:
                self.kernel.stop()


def main(job: Job) -> None:
    """Run one job.

    Raises:
        SystemExit: `ENDED`; `STOPPED`; `FAILED` where a part of the loop did; `NO_CONTROLLER` if no controller answered.
    """
    try:
        _run(job)
    except (TransportError, PlantError) as e:  # a plant that does not start
        sys.exit(f"hil: {e}")


def _run(job: Job) -> None:
    die_with_parent(job.parent)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    loops: list[RealLoop] = []
    begun = stopped = failed = False

    def stop(_signal: int, _frame: FrameType | None) -> None:
        nonlocal stopped
        stopped = True
        for loop in loops:
            loop.kernel.stop()

    def fail(kind: str, text: str) -> None:
        nonlocal failed
        if not begun:
            sys.exit(f"hil: {text}")
        failed = True
        sink.event(max(loops[0].rig.k, 0) * job.loop.experiment.period_ns, kind, text, severity="error")

    signal.signal(signal.SIGTERM, stop)
    sink = PipeSink(job.log_fd, channels_of(job.loop, on_can=job.link.on_can), job.loop.experiment.period_ns)
    timing = job.loop.experiment.timing
    wire = session_wire(os.urandom(KEY_BYTES), job.loop.experiment.slots)
    local = job.link.traits.in_process
    warm_up_rig = WarmUpRig(job.loop, session_wire(os.urandom(KEY_BYTES), REHEARSED), local).warm_up()
    # Behind the warm-up, which would keep the loops of other sessions from a CPU; before the link is opened, so that its threads
    # inherit the priority.
    scheduler = go_real_time(timing.priority, cpu_for(timing.affinity, "rig", job.link.traits), timing.idle == "awake")
    standard_output_is_free()  # results leave through the pipe, words through standard error
    node = ControlNode(job.loop) if local else None
    link = LocalLink(node) if node is not None else open_link(job.link.uri, "rig")
    with failing(job.loop, fail, link), link:  # what its close raises, too
        if isinstance(link, Discoverable):
            link.announce(about_rig(job.loop.rig))
        real = RealLoop(job, link, sink, wire, node)  # before the greeting: nothing stands between its last rehearsal and slot 0
        loops.append(real)
        is_open(job.meeting_fd)
        own = other_is_open(job.meeting_fd, job.hello_timeout_s, lambda: stopped)  # until then another one would answer
        limit_s = job.hello_timeout_s if own else 0.0
        result = Handshake(link, limit_s, lambda: stopped, monotonic_ns, wire, warm_up_rig.run, real.pause).greet()
        if not result.answered:
            if said := useless_frames(job.link.uri, link.counters, result.foreign):
                sys.stderr.write(f"hil: {said}\n")
            sink.close()
            raise SystemExit(NO_CONTROLLER)
        begun = True
        real.begin()
        sink.event(0, "started", f"rig started: {scheduler}", scheduler=scheduler)
        sink.commit()
        with failing(job.loop, fail, link):
            if not stopped:
                real.run()
            if not stopped:
                real.rig.compare(None if node is None else node.departed)
        sink.event(
            max(real.rig.k, 0) * job.loop.experiment.period_ns,
            "outcome",
            "rig ended",
            **real.rig.outcome(),
            scheduler=scheduler,
            overruns=real.overruns,
            link=structs.asdict(link.counters),
        )
        sink.commit()
        leave_real_time()
        end_after(CLOSES_S, FAILED if failed else STOPPED if stopped else ENDED)
    sink.close()
    raise SystemExit(FAILED if failed else STOPPED if stopped else ENDED)


def end_after(limit_s: float, status: int) -> None:
    """End this process, all of whose records are written, after so long, s, even if the link has not closed."""
    late = threading.Timer(limit_s, os._exit, (status,))
    late.daemon = True
    with suppress(RuntimeError):  # no room for a thread: all is written, and the end of the process closes the link
        late.start()
