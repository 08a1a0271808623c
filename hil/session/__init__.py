"""One run, from an experiment to its log and its summary. Read this file from top to bottom.

In virtual time a run is in this process, paced and stopped here; in real time in processes of its own. `replay` has the replay of
a log.
"""

from __future__ import annotations

import hashlib
import os
import signal
from collections.abc import Callable, Mapping
from errno import EMFILE, ENFILE
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Protocol

from hil.compose import compose
from hil.errors import DiskFull, HilError, Terminated
from hil.experiment import Experiment
from hil.log import DEPARTED, PLUG_IN_FAILED, WITHDRAWN
from hil.log.records import Channel
from hil.log.topics import channels_of
from hil.log.write import PayloadWriter, Sink, TeeSink, harmless, published
from hil.log.write.mcap_sink import McapSink
from hil.log.write.mcap_writer import Index
from hil.log.write.provenance import Provenance
from hil.measure import measures_of, quantities_of, refuse_unsound_measures
from hil.measure.signals import signals_of
from hil.measure.summary import summarise
from hil.measure.view import view_of
from hil.rig.loop import Loop
from hil.rig.session_link import SessionLink, link_of, no_link, refuse_undisturbed, refuse_unopened
from hil.runtime.clock import Clock, monotonic_ns, wall_clock
from hil.runtime.nodes import failure_of
from hil.runtime.real import machine
from hil.runtime.real.ending import Forced, StopSignals
from hil.runtime.virtual import rehearsal, run_virtual, simulate_as_logged
from hil.session import finished
from hil.session.finished import Session as Session
from transport.draws import REASONS
from transport.packets import SELECTIONS

if TYPE_CHECKING:
    from hil.runtime.changes import Changes

ClockName = Literal["virtual", "real"]
CARRIED = (
    "the link, a plug-in of the user's own, carries every frame as it was sent: answers are compared before it, the plant behind "
    "it; with auth=KEY an altered frame is refused"
)
"""What a certificate assumes of a link that is not ours."""


def simulated_session(loop: Loop, seed: int) -> Session:
    """Run a loop in virtual time without a file and sum it up: the session of `run_session`, without a log.

    Args:
        loop: the composed experiment; its own seed is not read.
        seed: seed of the run.
    """
    begun = monotonic_ns()
    experiment = loop.experiment
    run = simulate_as_logged(loop, seed)
    summary = summarise(view_of(run, experiment, loop.rig)) | finished.gains_in(loop)
    summary["wall_s"] = round((monotonic_ns() - begun) / 1e9, 3)
    summary["log"] = {"path": None, "sha256": "", "messages": sum(map(len, run.arrays.values())) + len(run.events), "dropped": 0}
    summary["problems"] = finished.messages_of(run, {WITHDRAWN, DEPARTED}) | finished.unreached(loop)
    status = finished.LEFT if finished.kinds_of(run) & {WITHDRAWN, DEPARTED} else 3 if summary["safety"] else 0
    return Session(log=run, summary=summary, status=status, experiment=experiment)


def run_session(
    experiment: Experiment,
    *,
    clock: ClockName = "virtual",
    link: str | None = None,
    path: Path,
    external: bool = False,
    wait_s: float | None = None,
    signals: str | None = None,
    index: Index = "full",
    onlooker: Onlooker | None = None,
    replace: bool = True,
) -> Session:
    """Run an experiment, log it, and sum it up.

    Args:
        experiment: the checked description.
        clock: ``virtual`` (one process, reproducible) or ``real`` (separate processes over ``link``).
        link: URI of the real link; the experiment's own by default.
        path: the log to write.
        external: an external controller answers on the link.
        wait_s: how long the rig waits for a first answer, s; by default 120 for an external controller.
        signals: where subscribers over zenoh read named signals as they come, such as ``zenoh:tcp/127.0.0.1:7448``.
        index: `full`, or `chunk` for a log of less than half the size that some viewers cannot read.
        onlooker: observes the run, may change it, and in virtual time pace it.
        replace: whether a log may be replaced that is there when the run begins.

    Raises:
        HilError: if the experiment cannot be composed, the log cannot be written, or the session could not start.
        DiskFull: not one record of the run could be written.
    """
    # 1. Compose: plug-ins, design, certificate. Nothing is started or written before this has passed.
    loop = compose(experiment, external=external)
    refuse_unsound_measures(loop, rehearsal)
    quantities_of(measures_of(experiment), signals_of(experiment.plant))  # measures that disagree are reported now
    on = no_link(loop.rig) if clock == "virtual" else link_of(loop.rig, link, external=external)
    refuse_undisturbed(experiment, loop.rig, on)
    if clock == "real":
        refuse_unopened(on, external=external)
    loop = loop.assuming(CARRIED) if clock == "real" and on.unproved else loop

    # 2. Say in the log where it comes from. In virtual time nothing of this machine or this day may stand there.
    provenance = Provenance(
        experiment=experiment.name,
        experiment_text=experiment.text,
        resolved=loop.experiment.resolved(),
        certificate=loop.certificate,
        seed=experiment.seed,
        clock=clock,
        link=on.uri,
        codes={"reason": REASONS, "selection": SELECTIONS},
        channels=on.channel_metadata(loop.rig),
        origins=experiment.origins(),
        session={} if clock == "virtual" else {
            "started": wall_clock(), "external_controller": str(external), "accepted_from": on.traits.commanders, **machine(),
        },
    )

    # 3. Run, with the log open. Real time is watched from here; virtual time runs here.
    begun = monotonic_ns()
    now = None if clock == "virtual" else (lambda: monotonic_ns() / 1e9)
    keep = finished.summary_needs(loop) if clock == "virtual" else None  # nothing is read back then
    table = channels_of(loop, on_can=on.on_can)
    with (
        published(signals, table, {} if onlooker is None else onlooker.begin(loop, table)) as publishing,
        McapSink(path, table, provenance, now=now, index=index, keep=keep, replace=replace) as sink,
    ):
        observers = harmless(publishing, sink)
        outcome: dict[str, Any] = {}
        if clock == "virtual":
            outcome = run_in_virtual_time(loop, sink, TeeSink(sink, observers) if observers else sink, onlooker)
        else:
            changes = None if onlooker is None else onlooker.changes
            outcome = run_in_real_time(loop, on, sink, external, wait_s, observers, changes)
        sink.commit()
        outcome |= finished.unreached(loop)
        problems = {name: text for name, text in outcome.items() if text}
        if problems:
            sink.summary({"problems": problems})
        log = sink.reader()
        gone = sink.gone()

    # 4. Sum up what the log says, and what only this process knows.
    wall_s = (monotonic_ns() - begun) / 1e9
    if sink.error is not None:
        message = f"disk full at slot {sink.failed_ns // experiment.period_ns}: {sink.error}"
        if not sink.messages:
            os.close(log)
            if gone is None:  # the name is still that of this log
                sink.discard()
            raise DiskFull(f"{message}; it took no record of the run; free some space, or write elsewhere (-o)")
        outcome["log_error"] = f"{message}; what was written before is kept: hil recover {path}"
    if gone is not None:
        outcome["log_lost"] = f"{path} {gone}"
    try:
        if keep is not None:
            run = finished.kept_run(sink, provenance)
        else:
            run = finished.read_back(path, whole=sink.error is None, descriptor=log)
        summary = finished.summary_of(run, loop, sink, outcome, wall_s)
        summary |= {"accepted_from": on.traits.commanders} | finished.gains_in(loop)
        summary["log"]["sha256"] = _sha256(log)
    finally:
        os.close(log)
    status = finished.status_of(run, sink, outcome)
    return Session(log=run if keep is None else path.absolute(), summary=summary, status=status, experiment=loop.experiment)


def _sha256(descriptor: int) -> str:
    with open(descriptor, "rb", closefd=False) as file:
        file.seek(0)
        return hashlib.file_digest(file, "sha256").hexdigest()


FORCE_S = 0.5
"""A slot in virtual time that has not ended so long after a signal is interrupted: everything stops within a second."""


class Onlooker(Protocol):
    """Observes a running session, changes its experiment, and in virtual time paces it."""

    @property
    def clock(self) -> Clock | None:
        """The clock of the run; None for one that does not wait."""

    def begin(self, loop: Loop, channels: Mapping[str, Channel]) -> Mapping[str, PayloadWriter]:
        """Take the loop that will run, and the channels of its log; return the receivers of its records, by topic."""

    @property
    def changes(self) -> Changes | None:
        """Called once for every slot: in virtual time at its beginning, in real time some slots ahead.

        None for a run that takes no changes.
        """

    def end(self) -> None:
        """Stop waiting, as the run is to end. A signal handler may call it."""


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
        sink.event(real.controller_lost_ns or real.pump.last_ns, PLUG_IN_FAILED, real.controller.failed, severity="error")
    elif real.controller_lost:
        out["controller_lost"] = real.controller_lost
        sink.event(real.controller_lost_ns, "controller lost", real.controller_lost, severity="error")
    counts: dict[str, Any] = dict(real.controller.counts)
    if counts:
        said = "what the controller and its end of the link counted"
        said += f"; processes that were killed and are not counted: {real.controller.silent}" * bool(real.controller.silent)
        sink.event(real.pump.last_ns, "controller ended", said, **counts)
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
