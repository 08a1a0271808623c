"""Real time: rig and controller as separate processes over a real link, watched by this one, which keeps the log."""

from __future__ import annotations

import ctypes
import os
import pickle
import sys
import threading
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Final

from msgspec import DecodeError
from msgspec.json import decode

from hil.errors import HilError
from hil.experiment.rig_tables import RESTART
from hil.log.topics import channels_of
from hil.log.write.pump import PumpReport, pump, rehearse
from hil.log.write.sinks import PayloadWriter, Sink
from hil.plugins.registry import OBJECT
from hil.rig.loop import Loop
from hil.rig.session_link import SessionLink
from hil.runtime.changes import Ahead, Changes, Dump, Lines
from hil.runtime.clock import monotonic_ns
from hil.runtime.real import controller_process, rig_process
from hil.runtime.real.child import Child, end_all
from hil.runtime.real.controller_process import Ended
from hil.runtime.real.ending import NO_CONTROLLER, StopSignals
from hil.runtime.real.machine import go_ahead_of_others, leave_to_loop
from transport.links.private_directory import bus_directory, clear_dead_channels

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


SHORTEST_S: Final = 1.0
PERIODS: Final = 50
PATIENCE: Final = 10
"""How many times longer a rig may be silent that is not stopped: a busy machine may keep it from a CPU for seconds."""

START_S: Final = 30.0
_LONGEST_LOOK_S: Final = 0.1


class HeartbeatTimeout:
    """Counts for how long no record has come while this process looked.

    A rig from which nothing comes any more is given up, within a bounded time.

    The time in which this process did not run itself (it was stopped, or the machine slept) counts for little: what the rig
    did in it still lies in the pipe.

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


POLL_S = 0.02
HELLO_TIMEOUT_S, EXTERNAL_TIMEOUT_S = 15.0, 120.0


@dataclass(slots=True)
class RealOutcome:
    """How a session in real time went, as this process saw it."""

    pump: PumpReport = field(default_factory=PumpReport)
    interrupted: int | None = None  # the signal that stopped the session
    rig_status: int | None = None
    rig_silent: str | None = None  # why the rig was given up
    controller_lost: str | None = None
    controller_lost_ns: int = 0  # session time
    controller: Ended = field(default_factory=Ended)  # what it says itself, once it has ended in order


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
    """Run a loop in real time; return when it has ended and nothing of it is left.

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
    """
    if external and link.traits.in_process:
        raise HilError(f"{link.uri} runs our controller in the rig's process: an external one needs a link")
    restarts = deque(first * loop.experiment.period_ns for first, _ in loop.rig.fault_schedule.restarts)
    if external and restarts:
        raise HilError("fault: controller-restart: hil cannot restart an external controller; end and start it by hand")
    clear_dead_channels(bus_directory())
    outcome = RealOutcome()
    (read_fd, write_fd), (counts_fd, counted_fd) = _two_pipes()
    parent = os.getpid()
    children: list[Child] = []
    period_ns = loop.experiment.period_ns
    to_come, lines, newest = Ahead(changes, period_ns), Lines(changes is not None), loop
    stop_pump = threading.Event()

    def keep_log() -> None:
        leave_to_loop(loop.experiment.timing.affinity, link.traits)
        go_ahead_of_others()
        channels = channels_of(loop, on_can=link.on_can)
        rehearse(channels)
        pump(read_fd, sink, channels, taps=taps, stop=stop_pump.is_set, report=outcome.pump)

    thread = threading.Thread(target=keep_log, name="log")
    with StopSignals() as signals:
        try:
            job = rig_process.Job(
                loop=loop, link=link, seed=seed, parent=parent, log_fd=write_fd,
                hello_timeout_s=hello_timeout_s or (EXTERNAL_TIMEOUT_S if external else HELLO_TIMEOUT_S),
                changes_fd=lines.open("rig"),
            )  # fmt: skip
            start, dump = _starter(loop)
            rig = start("rig", "hil.runtime.real.rig_process", job, lines.passed("rig", write_fd))
            children.append(rig)
            os.close(write_fd)
            write_fd = -1
            thread.start()
            controller = None

            def start_controller() -> Child:
                theirs = controller_process.Job(
                    loop=newest, link=link, parent=parent, counts_fd=counted_fd, changes_fd=lines.open("controller")
                )
                inherited = lines.passed("controller", counted_fd)
                children.append(start("controller", "hil.runtime.real.controller_process", theirs, inherited))
                return children[-1]

            if not external and not link.traits.in_process:
                controller = start_controller()
            silence = HeartbeatTimeout(float(loop.experiment.period), job.hello_timeout_s)
            free = FreeMemory(monotonic_ns())
            while rig.poll() is None and signals.seen is None:
                now_ns = monotonic_ns()
                free.look(now_ns)
                outcome.rig_silent = silence.look(now_ns, outcome.pump.records, rig.stopped())
                if outcome.rig_silent:
                    break
                for k, change in to_come.at(outcome.pump.last_ns if outcome.pump.records else -1):
                    lines.put("rig", k, change, dump)
                    if change.loop is not None:
                        newest = change.loop
                        restart = change.path == "fault" and change.value["kind"] == RESTART
                        if restart:
                            restarts = deque(sorted((*restarts, k * period_ns)))
                        if restart or change.path == "reference":  # all else that changes is the rig's
                            lines.put("controller", k, change, dump)
                lines.flush()
                if controller is not None and restarts and outcome.pump.records and outcome.pump.last_ns >= restarts[0]:
                    restarts.popleft()
                    controller.kill()  # a fault on the time line: it loses what it knew, and takes the time that a start takes
                    controller = start_controller()
                if controller is not None and outcome.controller_lost is None and controller.poll() is not None:
                    outcome.controller_lost, outcome.controller_lost_ns = controller.how(), outcome.pump.last_ns
                    if not outcome.pump.records:
                        break  # it never answered, so nothing runs yet
                rig.wait(POLL_S)
        finally:
            end_all(children)
            lines.close()
            os.close(counted_fd)
            outcome.controller = _said(counts_fd)
            if write_fd >= 0:
                os.close(write_fd)
            stop_pump.set()
            if thread.ident is not None:
                thread.join()
            os.close(read_fd)
    outcome.interrupted = signals.seen
    outcome.rig_status = children[0].poll()
    if signals.seen is None and not outcome.pump.records:
        if outcome.controller_lost is None and outcome.rig_status == NO_CONTROLLER:
            raise HilError(f"no controller answered on {link.uri} within {job.hello_timeout_s:g} s")
        why = outcome.rig_silent or outcome.controller.failed or outcome.controller_lost or children[0].how()
        raise HilError(f"{why} before the run began; see its message above, if any")
    return outcome


def _two_pipes() -> tuple[tuple[int, int], tuple[int, int]]:
    """Return two pipes, or none: without a descriptor for the second the first is closed."""
    first = os.pipe()
    try:
        return first, os.pipe()
    except OSError:
        for fd in first:
            os.close(fd)
        raise


def _starter(loop: Loop) -> tuple[Callable[..., Child], Dump]:
    """Return what starts a process with a loop, and what pickles one for it.

    What was built in Python takes its class along, or the folders it is found in.
    """
    if not any(origin.startswith(OBJECT) for origin in loop.experiment.origins().values()):
        return Child, pickle.dump
    from cloudpickle import dump

    return partial(Child, dump=dump, folders=[str(Path(folder).absolute()) for folder in sys.path]), dump


def _said(fd: int) -> Ended:
    """Return what a controller has written at its end."""
    with open(fd, "rb") as file:
        try:
            return decode(file.read(), type=Ended)
        except DecodeError:  # killed, or stopped and then killed
            return Ended()
