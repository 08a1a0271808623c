"""The run of a session: in virtual time in this process, paced and stopped here; or in real time in processes of its own."""

from __future__ import annotations

import signal
from collections.abc import Callable, Mapping
from errno import EMFILE, ENFILE
from typing import Any, Protocol

from hil.errors import HilError, Terminated
from hil.log.events import PLUG_IN_FAILED, WITHDRAWN
from hil.log.records import Channel
from hil.log.write.mcap_sink import McapSink
from hil.log.write.sinks import PayloadWriter, Sink
from hil.rig.loop import Loop
from hil.rig.session_link import SessionLink
from hil.runtime.changes import Changes
from hil.runtime.clock import Clock
from hil.runtime.real.ending import Forced, StopSignals, failure_of
from hil.runtime.virtual import run_virtual

FORCE_S = 0.5
"""A slot in virtual time that has not ended so long after a signal is interrupted: everything stops within a second."""


class Onlooker(Protocol):
    """Observes a running session, changes its experiment, and in virtual time paces it."""

    @property
    def clock(self) -> Clock | None:
        """The clock of the run; None for one that does not wait."""
        ...

    def begin(self, loop: Loop, channels: Mapping[str, Channel]) -> Mapping[str, PayloadWriter]:
        """Take the loop that will run, and the channels of its log; return the receivers of its records, by topic."""
        ...

    @property
    def changes(self) -> Changes | None:
        """Called once for every slot: in virtual time at its beginning, in real time some slots ahead.

        None for a run that takes no changes.
        """
        ...

    def end(self) -> None:
        """Stop waiting, as the run is to end. A signal handler may call it."""
        ...


def run_in_virtual_time(loop: Loop, log: McapSink, sink: Sink, onlooker: Onlooker | None) -> dict[str, Any]:
    stops: list[Callable[[], None]] = [] if onlooker is None else [onlooker.end]

    def stop(number: int) -> None:
        for each in stops:
            each()

    log.failed = lambda: stop(0)  # a run whose log is full ends
    out: dict[str, Any] = {}

    def failed(error: BaseException) -> bool:
        """Keep the exception of a user's own plant, controller or law, which the log reports at its end."""
        failure = failure_of(loop, error)
        if failure is not None:
            out[failure[0]] = failure[1]
        return bool(out) or isinstance(error, Forced)

    with StopSignals(stop, FORCE_S) as signals:
        rig = run_virtual(
            loop, loop.experiment.seed, sink, stoppable=stops.append, failed=failed,
            clock=None if onlooker is None else onlooker.clock, changes=None if onlooker is None else onlooker.changes,
        )  # fmt: skip
    end_ns = max(rig.k, 0) * loop.experiment.period_ns
    for kind, text in out.items():
        sink.event(end_ns, kind, text, severity="error")
    out = {kind.replace(" ", "_"): text for kind, text in out.items()}
    if signals.seen is not None:
        out |= _interrupted(signals.seen, sink, end_ns)
    sink.event(end_ns, "outcome", "rig ended", **rig.outcome())
    return out


def _interrupted(number: int, sink: Sink, t_ns: int) -> dict[str, Any]:
    name = signal.Signals(number).name
    sink.event(t_ns, "interrupted", f"stopped by {name}", severity="warning")
    return {"interrupted": name}


def run_in_real_time(
    loop: Loop, link: SessionLink, sink: McapSink, external: bool, wait_s: float | None,
    taps: Mapping[str, PayloadWriter] | None, changes: Changes | None,
) -> dict[str, Any]:
    from hil.runtime.real.supervisor import run_real

    try:
        real = run_real(
            loop, loop.experiment.seed, link, sink, external=external, hello_timeout_s=wait_s, taps=taps, changes=changes
        )
    except (HilError, Terminated):  # nothing ran: nothing is left behind
        sink.discard()
        raise
    except OSError as error:
        if error.errno not in (EMFILE, ENFILE) or sink.messages:
            raise
        sink.discard()
        raise HilError("no free file descriptor to start rig and controller; raise the limit: ulimit -n 64") from error
    sink.drop(real.pump.dropped)
    out: dict[str, Any] = {"torn_bytes": real.pump.torn_bytes, "malformed_records": real.pump.malformed}
    if real.controller.failed is not None:
        sink.event(real.controller_lost_ns, PLUG_IN_FAILED, real.controller.failed, severity="error")
    elif real.controller_lost:
        out["controller_lost"] = real.controller_lost
        sink.event(real.controller_lost_ns, "controller lost", real.controller_lost, severity="error")
    counts: dict[str, Any] = dict(real.controller.counts)
    if counts:
        sink.event(real.pump.last_ns, "controller ended", "what the controller and its end of the link counted", **counts)
    if real.controller.departed is not None:
        k, by = real.controller.departed
        message = f"certificate withdrawn: the controller left its table at slot {k} by {by}"
        sink.event(real.pump.last_ns, WITHDRAWN, message, slot=k, severity="error")
    unwanted = counts.get("refused", 0) + counts.get("contradicted", 0)
    if unwanted:
        out["controller_refused"] = f"the controller refused {unwanted} frames: they are not of this rig, or not of its slot"
    if real.interrupted is not None:
        out |= _interrupted(real.interrupted, sink, real.pump.last_ns)
    elif real.rig_lost is not None:
        out["rig_lost"] = real.rig_lost
        sink.event(real.pump.last_ns, "rig lost", real.rig_lost, severity="error")
    return out
