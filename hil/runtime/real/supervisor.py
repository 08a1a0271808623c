"""Real time: rig and controller as separate processes over a real link, watched by this one, which keeps the log.

Whether the rig process still lives is judged by its records.
"""

from __future__ import annotations

import ctypes
import os
import pickle
import socket
import sys
import threading
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import Final

from msgspec import Struct, field, structs

from hil.errors import HilError, Terminated
from hil.experiment.rig_tables import RESTART
from hil.log.topics import channels_of
from hil.log.write import PayloadWriter, Sink, together
from hil.log.write.pump import PumpReport, pump, rehearse
from hil.plugins.registry import OBJECT
from hil.rig.loop import Loop
from hil.rig.session_link import SessionLink
from hil.runtime.changes import Change, Changes, ChangeSchedule, ChangeSenders, Dump
from hil.runtime.clock import monotonic_ns
from hil.runtime.real import controller_process, go_ahead_of_others, leave_to_loop, rig_process
from hil.runtime.real.child import Child, end_all, is_stopped
from hil.runtime.real.controller_process import ControllerReport, read_reports
from hil.runtime.real.ending import ENDED, FAILED, NO_CONTROLLER, STOPPED, StopSignals
from transport.links.private_directory import bus_directory, clear_dead_channels

SHORTEST_S: Final = 1.0
PERIODS: Final = 50
PATIENCE: Final = 10
"""A rig that is not stopped may be silent this many times longer: a busy machine may keep it from a CPU for seconds."""

START_S: Final = 30.0
_LONGEST_LOOK_S: Final = 0.1


class HeartbeatTimeout:
    """Measures for how long no record has come, and gives the rig up after a bounded time.

    Time in which this process itself did not run (it was stopped, or the machine slept) counts as `_LONGEST_LOOK_S` at most: the
    records of that time still lie in the pipe.

    Args:
        period_s: sample period, s: every slot leaves records.
        hello_s: how long the rig waits for a controller before its first record, s.
    """

    def __init__(self, period_s: float, hello_s: float) -> None:
        self.stopped_s = max(SHORTEST_S, PERIODS * period_s)
        self.silent_s = PATIENCE * self.stopped_s
        self._start_s = hello_s + START_S
        self._looked_ns: int | None = None
        self._records = 0
        self._quiet_s = self._stopped_for_s = 0.0

    def look(self, now_ns: int, records: int, stopped: bool) -> str | None:
        """Return why the rig is given up, None while it need not be.

        Args:
            now_ns: a monotonic clock, ns.
            records: records that have come so far.
            stopped: whether the rig's process is stopped now.
        """
        passed = 0.0 if self._looked_ns is None else min((now_ns - self._looked_ns) / 1e9, _LONGEST_LOOK_S)
        self._looked_ns = now_ns
        if records != self._records:
            self._records, self._quiet_s = records, 0.0
        else:
            self._quiet_s += passed
        self._stopped_for_s = self._stopped_for_s + passed if stopped else 0.0
        if min(self._stopped_for_s, self._quiet_s) >= self.stopped_s:
            return f"the rig process is stopped (SIGSTOP): no record came for {self.stopped_s:g} s"
        limit_s = self.silent_s if records else max(self.silent_s, self._start_s)
        if self._quiet_s >= limit_s:
            return f"the rig process is alive and silent: no record came for {limit_s:g} s"
        return None


EVERY_NS: Final = 1_000_000_000


class FreeMemory:
    """Gives back what the C library keeps of freed memory, once a second; without glibc it does nothing.

    A process that runs for days then holds what it uses, and not what it once used.

    Args:
        now_ns: monotonic time, ns.
    """

    def __init__(self, now_ns: int) -> None:
        self._trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        self._due_ns = now_ns + EVERY_NS

    def look(self, now_ns: int) -> None:
        """Give it back if it is time; takes less than a millisecond."""
        if self._trim is not None and now_ns >= self._due_ns:
            self._due_ns = now_ns + EVERY_NS
            self._trim(0)


POLL_S = 0.02
HELLO_TIMEOUT_S, EXTERNAL_TIMEOUT_S = 15.0, 120.0


class RealOutcome(Struct):
    """How a session in real time went, as this process saw it."""

    pump: PumpReport = field(default_factory=PumpReport)
    interrupted: int | None = None  # the signal that stopped the session
    rig_lost: str | None = None  # why the rig was given up, or how it ended out of order
    controller_lost: str | None = None
    controller_lost_ns: int = 0  # session time
    controller: ControllerReport = field(default_factory=ControllerReport)  # what it and those before it said, if not killed


class Processes:
    """The rig and controller processes of a session: their start, the restarts of the controller, and the changes sent to both.

    Args:
        loop: the composed experiment.
        link: between rig and controller.
        report_fd: file that takes the controller's report.
        changes: of the experiment while it runs; None for none.
    """

    def __init__(self, loop: Loop, link: SessionLink, report_fd: int, changes: Changes | None) -> None:
        self._loop, self._link, self._report_fd = loop, link, report_fd
        self._period_ns, self._parent = loop.experiment.period_ns, os.getpid()
        self.schedule, self._senders = ChangeSchedule(changes, self._period_ns), ChangeSenders(changes is not None)
        self._restarts = deque(first * self._period_ns for first, _ in loop.rig.fault_schedule.restarts)
        self._start, self._dump = _starter(loop)
        self._controller: Child | None = None
        self.controllers = 0  # started
        self._meeting: dict[str, socket.socket] = {}
        self._children: list[Child] = []

    def start_rig(self, seed: int, log_fd: int, hello_timeout_s: float, own_controller: bool) -> Child:
        """Start the rig process; see `rig_process.Job`. With a controller of its own it takes no other one."""
        if own_controller:
            self._meeting = dict(zip(("rig", "controller"), socket.socketpair(), strict=True))
        job = rig_process.Job(
            loop=self._loop, link=self._link, seed=seed, parent=self._parent, log_fd=log_fd, hello_timeout_s=hello_timeout_s,
            changes_fd=self._senders.open("rig"), meeting_fd=self._meeting_of("rig"),
        )  # fmt: skip
        return self._started("rig", rig_process.__name__, job, log_fd)

    def start_controller(self) -> None:
        """Start the controller process with the loop as it is after the last change."""
        job = controller_process.Job(
            loop=self._loop, link=self._link, parent=self._parent, report_fd=self._report_fd,
            changes_fd=self._senders.open("controller"), meeting_fd=self._meeting_of("controller"),
        )  # fmt: skip
        for sent in self.schedule.undecided:
            self._tell_controller(*sent)
        self.controllers += 1
        self._controller = self._started("controller", controller_process.__name__, job, self._report_fd)

    def _meeting_of(self, name: str) -> int:
        return self._meeting[name].fileno() if name in self._meeting else -1

    def _started(self, name: str, module: str, job: object, fd: int) -> Child:
        meeting = self._meeting.pop(name, None)
        with meeting or nullcontext():  # the other end sees that the process has ended
            more = () if meeting is None else (meeting.fileno(),)
            self._children.append(self._start(name, module, job, self._senders.passed(name, fd, *more)))
        return self._children[-1]

    def send_changes(self, now_ns: int) -> None:
        """Send the changes that are due; `now_ns`: session time, ns, below 0 before slot 0."""
        for k, change in self.schedule.taken():
            self._loop = change.loop or self._loop
            if _is_restart(change):
                self._restarts = deque(sorted((*self._restarts, k * self._period_ns)))
        for k, change in self.schedule.at(now_ns):
            self._tell_controller(k, change)
            self._senders.put("rig", k, change, self._dump)
        self._senders.flush()

    def _tell_controller(self, k: int, change: Change) -> None:
        """Queue a change for the controller: of those that are the rig's alone, only that there is one."""
        own = _is_restart(change) or change.path == "reference"
        self._senders.put("controller", k, change if own else structs.replace(change, loop=None), self._dump)

    def restart_controller(self, now_ns: int) -> None:
        """Restart the controller where a fault on the time line says so: it loses its memory, and takes the time of a start."""
        if self._controller is not None and self._restarts and now_ns >= self._restarts[0]:
            self._restarts.popleft()
            self._controller.kill()
            self.start_controller()

    def lost_controller(self) -> str | None:
        """Return how the controller process ended, None while it runs, or where there is none."""
        return self._controller.how() if self._controller is not None and self._controller.poll() is not None else None

    def end(self) -> None:
        """End both processes, and send nothing more."""
        end_all(self._children)
        self._senders.close()
        for meeting in self._meeting.values():
            meeting.close()


def run_real(
    loop: Loop,
    seed: int,
    link: SessionLink,
    sink: Sink,
    *,
    external: bool = False,
    hello_timeout_s: float | None = None,
    taps: Mapping[str, PayloadWriter] | None = None,
    changes: Changes | None = None,
) -> RealOutcome:
    """Run a loop in real time; return when both processes have ended.

    Args:
        loop: the composed experiment.
        seed: seed of the run.
        link: between rig and controller.
        sink: takes every record, in this process.
        external: do not start a controller: an external program answers on the link.
        hello_timeout_s: how long the rig waits for a first answer, s.
        taps: see :func:`hil.log.write.pump.pump`.
        changes: of the experiment while it runs; None for none.

    Raises:
        HilError: if rig or controller ended before the run began, or no controller answered.
        Terminated: a signal came before the run began.
    """
    if external and loop.rig.fault_schedule.restarts:
        raise HilError("fault: controller-restart: hil cannot restart an external controller; end and start it by hand")
    clear_dead_channels(bus_directory())
    hello_s = hello_timeout_s or (EXTERNAL_TIMEOUT_S if external else HELLO_TIMEOUT_S)
    outcome = RealOutcome()
    stop_pump = threading.Event()

    def keep_log() -> None:
        leave_to_loop(loop.experiment.timing.affinity, link.traits)
        go_ahead_of_others()
        channels = channels_of(loop, on_can=link.on_can)
        rehearse(channels)
        observed = together(taps or {}, processes.schedule.listeners())
        pump(read_fd, sink, channels, taps=observed, stop=stop_pump.is_set, report=outcome.pump)

    thread = threading.Thread(target=keep_log, name="log")
    with open(os.memfd_create("report"), "rb") as report, StopSignals() as signals:
        processes = Processes(loop, link, report.fileno(), changes)
        read_fd, write_fd = os.pipe()
        try:
            own = not external and not link.traits.in_process
            rig = processes.start_rig(seed, write_fd, hello_s, own)
            os.close(write_fd)
            write_fd = -1
            thread.start()
            if own:
                processes.start_controller()
            heartbeat = HeartbeatTimeout(float(loop.experiment.period), hello_s)
            free = FreeMemory(monotonic_ns())
            while rig.poll() is None and signals.seen is None and _goes_on(rig, processes, heartbeat, outcome):
                free.look(monotonic_ns())
                rig.wait(POLL_S)
        finally:
            lost = processes.lost_controller()
            processes.end()
            if write_fd >= 0:
                os.close(write_fd)
            stop_pump.set()
            if thread.ident is not None:
                thread.join()
            os.close(read_fd)
        outcome.controller = read_reports(report, processes.controllers)
    outcome.interrupted = signals.seen
    status = rig.poll()
    if not outcome.pump.records:
        if signals.seen is not None:
            raise Terminated(signals.seen)
        lost = outcome.controller_lost or lost
        if lost is None and status == NO_CONTROLLER:
            raise HilError(f"no controller answered on {link.uri} within {hello_s:g} s")
        why = outcome.rig_lost or outcome.controller.failed or lost or rig.how()
        raise HilError(f"{why} before the run began; see its message above, if any")
    if status not in (ENDED, FAILED) and (status != STOPPED or signals.seen is None):
        outcome.rig_lost = outcome.rig_lost or rig.how()
    return outcome


def _goes_on(rig: Child, processes: Processes, heartbeat: HeartbeatTimeout, outcome: RealOutcome) -> bool:
    """Do what is due while both processes run; return False where the session cannot go on, with the reason in the outcome."""
    now_ns, records = monotonic_ns(), outcome.pump.records
    session_ns = outcome.pump.last_ns if records else -1
    outcome.rig_lost = heartbeat.look(now_ns, records, is_stopped(rig.pid))
    if outcome.rig_lost:
        return False
    processes.send_changes(session_ns)
    processes.restart_controller(session_ns)
    if outcome.controller_lost is None:
        outcome.controller_lost, outcome.controller_lost_ns = processes.lost_controller(), outcome.pump.last_ns
    return outcome.controller_lost is None or bool(records)  # a controller that ended before slot 0 never answered


def _is_restart(change: Change) -> bool:
    return change.path == "fault" and bool(change.value["kind"] == RESTART)


def _starter(loop: Loop) -> tuple[Callable[..., Child], Dump]:
    """Return the function that starts a process, and the one that pickles its loop.

    An object that was built in Python is pickled with its class, or with the folders in which its module is found.
    """
    if not any(origin.startswith(OBJECT) for origin in loop.experiment.origins().values()):
        return Child, pickle.dump
    from cloudpickle import dump

    return partial(Child, dump=dump, folders=[str(Path(folder).absolute()) for folder in sys.path]), dump
