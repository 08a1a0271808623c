"""The controller process: the software under test. Frames in, send-all packets out; it logs nothing and times nothing.

A `hil.runtime.real.child.Child` runs it.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from types import FrameType
from typing import IO

from msgspec import DecodeError, Struct, field, structs
from msgspec.json import decode, encode

from hil.errors import Terminated
from hil.rig.loop import Loop
from hil.rig.session_link import SessionLink
from hil.runtime.changes import ChangeReceiver
from hil.runtime.clock import monotonic_ns
from hil.runtime.nodes import failing
from hil.runtime.nodes.controller_node import ControlNode
from hil.runtime.real import cpu_for, die_with_parent, go_real_time, leave_real_time
from hil.runtime.real.child import is_open, other_is_open
from hil.runtime.real.ending import useless, useless_frames
from hil.runtime.real.exchange import warm_up_controller
from transport.links import Link, OneOfARole, TransportError
from transport.links.opening import open_link
from transport.links.zenoh_refusals import standard_output_is_free

IDLE_S = 0.2  # longest wait for one frame, so that a signal is seen soon
LONGEST_REPORT = 1 << 16
ENOUGH = 20  # frames of no use; a rig that waits for its controller sends so many in a second


class Job(Struct, frozen=True, kw_only=True):
    """What the controller process needs."""

    loop: Loop
    link: SessionLink
    parent: int
    report_fd: int = -1  # where its counters go at its end
    changes_fd: int = -1  # brings other references, and restarts of the controller
    meeting_fd: int = -1  # to the rig process of the session


class ControllerReport(Struct, frozen=True, kw_only=True):
    """What a controller process reports at its end.

    Args:
        counts: what it and its link counted.
        departed: the slot in which its answers left its table, and by how much.
        failed: the exception of a user's control law or link, in words.
        silent: how many processes of a session reported nothing, as they were killed.
    """

    counts: dict[str, int] = field(default_factory=dict)
    departed: tuple[int, str] | None = None
    failed: str | None = None
    silent: int = 0


def stop_on_sigterm() -> None:
    """Turn SIGTERM into `Terminated`, and leave Ctrl-C to the parent, which ends everything in order."""

    def handler(number: int, _frame: FrameType | None) -> None:
        raise Terminated(number)

    signal.signal(signal.SIGTERM, handler)
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def serve(
    loop: Loop, uri: str, before_open: Callable[[], object] = lambda: None, opened: Callable[[], object] = lambda: None,
    at_end: Callable[[ControllerReport], object] = lambda report: None, changes_fd: int = -1,
    warn: Callable[[str], object] | None = None,
) -> str:  # fmt: skip
    """Answer sensor frames on a link until stopped, or until a law or link of the user's own raises; return what that says.

    Args:
        loop: the composed experiment.
        uri: the link.
        before_open: called after the warm-up, which takes long, and before the link opens: its threads inherit priority and CPU.
        opened: called once the link is open.
        at_end: called with what was counted, and with what a part raised that fails.
        changes_fd: brings changes; the changed loop itself says from which slot on they act.
        warn: called once where `ENOUGH` frames came before the first one that is answered, with the reasons.

    Raises:
        TransportError: the link cannot be opened, or the rig has another controller.
    """
    warm_up_controller(loop)
    node = ControlNode(loop)
    before_open()
    raised: list[str] = []
    changes = ChangeReceiver(changes_fd)

    def fail(_kind: str, text: str) -> None:
        raised.append(text)
        at_end(ControllerReport(failed=text[:2000]))

    link = open_link(uri, "controller", float(loop.experiment.period))
    with failing(loop, fail, link), link:  # what its close raises, too
        opened()
        try:
            with failing(loop, fail, link):
                while not _answer_next(node, link, changes):
                    seen, others = link.counters, node.counts.malformed
                    if warn is not None and useless(seen, others) >= ENOUGH:
                        warn(useless_frames(uri, seen, others, "no question of a rig: another pad= or wire version"))
                        warn = None
                while True:
                    _answer_next(node, link, changes)
        finally:
            counters, counts = structs.asdict(link.counters), structs.asdict(node.counts)
            both = {name: counters.get(name, 0) + counts.get(name, 0) for name in counters | counts}
            at_end(ControllerReport(counts=both, departed=node.departed))
    return raised[0]


def _answer_next(node: ControlNode, link: Link, changes: ChangeReceiver) -> bool:
    """Take the next frame, if one comes in time; return whether it was answered."""
    answer, data = None, link.receive(IDLE_S)
    if data is not None:
        answer = node.on_frame(data, monotonic_ns())
        if answer is not None:
            link.send(answer)
        for _, change, acts in changes.due(node.next_slot, ahead=True):
            if acts and change.loop is not None:
                node.change(change.loop, new_controller=False)
    elif isinstance(link, OneOfARole):  # no packet comes where the rig has accepted another controller
        link.check_alone()
    return answer is not None


def _write(fd: int, report: ControllerReport) -> None:
    if fd >= 0:
        with suppress(OSError):
            os.write(fd, b"\n" + encode(report))


def read_reports(file: IO[bytes], started: int) -> ControllerReport:
    """Return what the controller processes of a session reported, as one report: what each counted is added up.

    Args:
        file: a report a line; a process that was killed wrote none, or a part of one.
        started: number of controller processes.
    """
    file.seek(0)
    found = []
    for line in file.read(LONGEST_REPORT).splitlines():
        with suppress(DecodeError):
            found.append(decode(line, type=ControllerReport))
    return ControllerReport(
        counts={name: sum(each.counts.get(name, 0) for each in found) for each in found for name in each.counts},
        departed=next((each.departed for each in found if each.departed), None),
        failed=next((each.failed for each in found if each.failed), None),
        silent=started - sum(bool(each.counts) for each in found),
    )


def main(job: Job) -> None:
    """Run one job."""
    standard_output_is_free()
    timing = job.loop.experiment.timing
    try:
        stop_on_sigterm()
        die_with_parent(job.parent)
        cpu = cpu_for(timing.affinity, "controller", job.link.traits)

        def before_open() -> None:
            """Wait for the rig: of several sessions on one link, the one whose rig was first has the controller too."""
            go_real_time(max(timing.priority - 1, 1), cpu)
            while not other_is_open(job.meeting_fd):
                signal.pause()  # the session ends, as its rig did

        serve(
            job.loop, job.link.uri, before_open, partial(is_open, job.meeting_fd), partial(_write, job.report_fd), job.changes_fd
        )
    except Terminated:
        leave_real_time()
    except TransportError as e:
        sys.exit(f"hil: {e}")
