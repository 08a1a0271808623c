"""One run, from an experiment to its log and its summary. Read this file from top to bottom."""

from __future__ import annotations

import hashlib
import json
import os
import signal
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from errno import EMFILE, ENFILE
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Protocol

import msgspec

from hil.compose.loop import Loop, compose
from hil.errors import DiskFull, HilError
from hil.experiment import Experiment
from hil.log.events import DEPARTED, PLANT_FAILED, PLUG_IN_FAILED, WITHDRAWN, decode_event, to_json
from hil.log.read.arrays import StructuredArray
from hil.log.records import Channel
from hil.log.run import Run
from hil.log.topics import BUS, CA, SC, channels_of
from hil.log.write.live_signals import published, together
from hil.log.write.mcap_sink import McapSink
from hil.log.write.mcap_writer import Index
from hil.log.write.provenance import Provenance
from hil.log.write.sinks import MemorySink, PayloadWriter, RecordObservers, Sink, TeeSink
from hil.measure.measure import Named, measures_of, own_measures, quantities_of
from hil.measure.signals import signals_of
from hil.measure.summary import summarise
from hil.measure.view import APPLIED, MEASUREMENT, REFERENCE, TIMING, RunView, view_of
from hil.rig.link_faults import refuse_undisturbed
from hil.rig.session_link import SessionLink, link_of, no_link
from hil.runtime.changes import Changes
from hil.runtime.nodes.failures import failure_of
from hil.runtime.real.ending import ENDED, FAILED, Forced, StopSignals
from hil.runtime.real.machine import machine
from hil.runtime.time.clock import Clock, monotonic_ns, wall_clock
from hil.runtime.virtual import run_virtual
from transport.draws import REASONS
from transport.packets import SELECTIONS

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure

ClockName = Literal["virtual", "real"]
FORCE_S = 0.5
"""A run in virtual time whose slot does not end for so long after a signal is ended in it: everything stops within a second."""

CARRIED = (
    "the link, a plug-in of the user's own, carries every frame as it was sent: answers are compared before it, the plant behind "
    "it; with auth=KEY an altered frame is refused"
)
"""What a certificate assumes of a link that is not ours."""

LEFT = 7
"""Exit status where a plant or a controller was not, in the run, what it says that it is."""

INTRUSIONS = {"second controller": 5, "flood": 6}  # events that say that another process sends on the link: exit status


class Onlooker(Protocol):
    """Who looks at a run while it goes on, changes it, and in virtual time paces it."""

    @property
    def clock(self) -> Clock | None:
        """The clock of the run; None for one that does not wait."""
        ...

    def begin(self, loop: Loop, channels: Mapping[str, Channel]) -> Mapping[str, PayloadWriter]:
        """Take the loop that will run, and the table of its log; return what takes its records, by topic."""
        ...

    @property
    def changes(self) -> Changes | None:
        """Asked for what changes in every slot, once: in virtual time as it begins, in real time some slots ahead.

        None for a run that takes no change.
        """
        ...

    def end(self) -> None:
        """The run is to end: wait for nothing more. A signal handler may call it."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Session:
    """What a finished run leaves behind.

    Args:
        log: returns the log, read when it is first asked for.
        summary: what ``hil run --json`` prints.
        status: exit status: 0, 1 the rig died or the log is not whole, 3 stopped by safety,
            5 a second controller answered too, 6 the link was flooded, 7 the plant or the controller was not what it says,
            130 or 143 interrupted.
        experiment: what ran.
    """

    log: Callable[[], Run]
    summary: dict[str, Any]
    status: int
    experiment: Experiment | None = None

    @property
    def run(self) -> Run:
        """The log, read back; it takes memory for every record."""
        return self.log()

    @property
    def metrics(self) -> dict[str, Any]:
        """The numbers of the experiment's measures, by name; ``summary["units"]`` has their units."""
        return Named("metric", self.summary["metrics"])

    @property
    def arrays(self) -> Mapping[str, StructuredArray]:
        """Topic to records, a structured numpy array each; field ``t_ns`` is the session time."""
        return self.run.arrays

    def to_pandas(self) -> dict[str, pandas.DataFrame]:
        """Return the arrays as tables of pandas; see `hil.notebook.tables`."""
        from hil.notebook import tables

        return tables(self.run)

    def to_xarray(self) -> dict[str, xarray.Dataset]:
        """Return the arrays as data sets of xarray; see `hil.notebook.datasets`."""
        from hil.notebook import datasets

        return datasets(self.run)

    def plot(self, path: str | Path | None = None, *, width_mm: float = 85.0, height_mm: float = 70.0) -> Figure:
        """Return outputs, reference and inputs as a figure of matplotlib, and write it to a file; see `hil.notebook.figure`."""
        from hil.notebook import figure

        return figure(self.run, path, width_mm=width_mm, height_mm=height_mm)

    def _repr_html_(self) -> str:
        from hil.notebook import cell

        of = self.experiment
        quantities = () if of is None else quantities_of(measures_of(of), signals_of(of.plant))
        return cell(self.run, self.summary, repr(self), quantities)

    def __repr__(self) -> str:
        s, metrics = self.summary, self.summary["metrics"]
        number, value = next(((k, v) for k, v in metrics.items() if isinstance(v, float)), ("", None))
        value_text = "" if value is None else f", {number} {value:.5g}"
        safety = ", stopped by safety" if s.get("safety") else ""
        return f"<Session {s['experiment']} seed {s['seed']}, {s['clock']} time, {s['slots']} slots{value_text}{safety}>"


def simulate(loop: Loop, seed: int, topics: Collection[str] | None = None) -> Run:
    """Run a loop in virtual time without a file, keeping only some topics: for sweeps and tests."""
    sink = MemorySink(channels_of(loop), topics)
    rig = run_virtual(loop, seed, sink)
    return Run.from_memory(sink, summary=dict(rig.outcome()))


def refuse_unsound_measures(loop: Loop) -> None:
    """Hold measures of the user's own to `check_measure`, over a short run; see `hil.measure.check.check_own_measures`."""
    if own_measures(loop.experiment):
        from hil.measure.check import check_own_measures

        check_own_measures(loop.experiment, lambda: rehearsal(loop))


def rehearsal(loop: Loop, slots: int = 20) -> RunView:
    """Return the view of the first slots of a run, which ends in order where a plug-in fails."""
    experiment = loop.experiment
    short = msgspec.structs.replace(experiment, duration=min(slots, experiment.slots) * experiment.period)
    sink = MemorySink(channels_of(loop))
    run_virtual(replace(loop, experiment=short), 0, sink, failed=lambda error: not isinstance(error, KeyboardInterrupt))
    return view_of(_run_of(sink, loop, 0), experiment, loop.rig)


def _run_of(sink: MemorySink, loop: Loop, seed: int, **about: Any) -> Run:
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


def simulated_session(loop: Loop, seed: int) -> Session:
    """Run a loop in virtual time without a file and sum it up: the session of `run_session`, without a log.

    Args:
        loop: the composed experiment; its own seed is not read.
        seed: seed of the run.
    """
    begun = monotonic_ns()
    experiment = loop.experiment
    sink = MemorySink(channels_of(loop))
    rig = run_virtual(loop, seed, sink)
    run = _run_of(sink, loop, seed, summary=dict(rig.outcome()))
    summary = summarise(view_of(run, experiment, loop.rig)) | _gains(loop)
    summary["wall_s"] = round((monotonic_ns() - begun) / 1e9, 3)
    summary["log"] = {"path": None, "sha256": "", "messages": sum(map(len, sink.payloads.values())), "dropped": 0}
    summary["problems"] = _told(run, {WITHDRAWN, DEPARTED}) | _unreached(loop)
    status = LEFT if _kinds(run) & {WITHDRAWN, DEPARTED} else 3 if summary["safety"] else 0
    return Session(log=lambda: run, summary=summary, status=status, experiment=experiment)


def run_session(
    experiment: Experiment,
    *,
    clock: ClockName = "virtual",
    link: str | None = None,
    path: Path,
    external: bool = False,
    wait_s: float | None = None,
    taps: Mapping[str, PayloadWriter] | None = None,
    signals: str | None = None,
    index: Index = "full",
    onlooker: Onlooker | None = None,
) -> Session:
    """Run an experiment, log it, and sum it up.

    Args:
        experiment: the checked description.
        clock: ``virtual`` (one process, reproducible) or ``real`` (separate processes over ``link``).
        link: URI of the real link; the experiment's own by default.
        path: the log to write.
        external: an external controller answers on the link.
        wait_s: how long the rig waits for a first answer, s; by default 120 for an external controller.
        taps: topic to a function that gets its records as they come, for a live view.
        signals: where subscribers over zenoh read named signals as they come, such as ``zenoh:tcp/127.0.0.1:7448``.
        index: `full`, or `chunk` for a log of less than half the size that some viewers cannot read.
        onlooker: who looks at the run, and may change it, and in virtual time pace it.

    Raises:
        HilError: if the experiment cannot be composed, the log cannot be written, or the session could not start.
        DiskFull: not one record of the run could be written.
    """
    # 1. Compose: plug-ins, design, certificate. Nothing is started or written before this has passed.
    loop = compose(experiment, external=external)
    refuse_unsound_measures(loop)
    quantities_of(measures_of(experiment), signals_of(experiment.plant))  # measures that disagree are reported now
    on = no_link(loop.rig) if clock == "virtual" else link_of(loop.rig, link)
    refuse_undisturbed(experiment, loop.rig, on)
    loop = _assuming(loop, CARRIED) if clock == "real" and on.unproved else loop

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
        channels=on.said(loop.rig),
        origins=experiment.origins(),
        session={} if clock == "virtual" else {
            "started": wall_clock(), "external_controller": str(external), "accepted_from": on.traits.commanders, **machine(),
        },
    )

    # 3. Run, with the log open. Real time is watched from here; virtual time runs here.
    begun = monotonic_ns()
    now = None if clock == "virtual" else (lambda: monotonic_ns() / 1e9)
    keep = _summary_needs(loop) if clock == "virtual" else None  # nothing is read back then
    table = channels_of(loop, on_can=on.on_can)
    if onlooker is not None:
        taps = together(taps or {}, onlooker.begin(loop, table))
    with (
        published(signals, table, taps) as observers,
        McapSink(path, table, provenance, now=now, index=index, keep=keep) as sink,
    ):
        outcome: dict[str, Any] = {}
        if clock == "virtual":
            outcome = _run_in_virtual_time(loop, sink, TeeSink(sink, RecordObservers(observers)) if observers else sink, onlooker)
        else:
            outcome = _run_real(loop, on, sink, external, wait_s, observers, None if onlooker is None else onlooker.changes)
        sink.commit()
        outcome |= _unreached(loop)
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
            run = _kept(sink, provenance)
        else:
            run = _read_back(path, whole=sink.error is None, descriptor=log)
        summary = _summary(run, loop, sink, outcome, wall_s)
        summary |= {"accepted_from": on.traits.commanders} | _gains(loop)
        summary["log"]["sha256"] = _sha256(log)
    finally:
        os.close(log)
    status = _status(run, sink, outcome)
    read = cache(partial(_read_back, path)) if keep is not None else lambda: run
    return Session(log=read, summary=summary, status=status, experiment=loop.experiment)


def _assuming(loop: Loop, assumption: str) -> Loop:
    verdict = loop.verdict
    if verdict is None or not verdict.certified:
        return loop
    return replace(loop, verdict=replace(verdict, assumptions=(*verdict.assumptions, assumption)))


def _unreached(loop: Loop) -> dict[str, str]:
    return {"faults": loop.rig.unreached} if loop.rig.unreached else {}


def _gains(loop: Loop) -> dict[str, Any]:
    return {"gains": None if loop.gains is None else loop.gains.to_json()}


def _summary_needs(loop: Loop) -> dict[str, Sequence[str] | None] | None:
    """Return what a summary needs of a log in virtual time, topic to fields (None: all); None where it needs raw frames."""
    table = channels_of(loop)
    keep: dict[str, Sequence[str] | None] = dict.fromkeys((MEASUREMENT, REFERENCE, APPLIED, TIMING))
    for topic, laws in ((SC.name, loop.rig.laws[:-1]), (CA.name, loop.rig.laws[-1:])):
        counted = [name for name in table[topic].schema.dtype.names or () if name in ("mode", "node", "reason")]
        keep[topic] = counted if all(law.family == "age" for law in laws) else None
    wanted = {topic for measure in measures_of(loop.experiment) for topic in measure.topics}
    keep |= dict.fromkeys((wanted | {BUS.name}) & table.keys())
    return None if any(table[topic].schema.raw for topic in keep) else keep


def _kept(sink: McapSink, provenance: Provenance) -> Run:
    """Return the run of what was kept while the log was written, as the log says it."""
    arrays = sink.kept.arrays()
    return Run(
        arrays=arrays,
        schemas={topic: sink.kept.schemas[topic] for topic in arrays},
        events=[decode_event(payload) for payload in sink.kept.events()],
        metadata=provenance.metadata()["hilrig"],
        codes={name: list(words) for name, words in provenance.codes.items()},
        experiment_text=provenance.experiment_text,
        resolved=json.loads(to_json(provenance.resolved)),
        certificate=json.loads(to_json(provenance.certificate or {})),
    )


def _read_back(path: Path, *, whole: bool = True, descriptor: int | None = None) -> Run:
    from hil.log.read.run import read_run  # a run in virtual time keeps its columns, and reads no log

    return read_run(path, whole=whole, descriptor=descriptor)


def _sha256(descriptor: int) -> str:
    with open(descriptor, "rb", closefd=False) as file:
        file.seek(0)
        return hashlib.file_digest(file, "sha256").hexdigest()


def _run_in_virtual_time(loop: Loop, log: McapSink, sink: Sink, onlooker: Onlooker | None) -> dict[str, Any]:
    stops: list[Callable[[], None]] = [] if onlooker is None else [onlooker.end]

    def stop(number: int) -> None:
        for each in stops:
            each()

    log.failed = lambda: stop(0)  # nothing that the log cannot hold is computed
    out: dict[str, Any] = {}

    def failed(error: BaseException) -> bool:
        """Keep what a plant, a controller or a law of the user's own raised in mid-run: the log is closed with it."""
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


def _run_real(
    loop: Loop, link: SessionLink, sink: McapSink, external: bool, wait_s: float | None,
    taps: Mapping[str, PayloadWriter] | None, changes: Changes | None,
) -> dict[str, Any]:
    from hil.runtime.real.supervisor import run_real

    try:
        real = run_real(
            loop, loop.experiment.seed, link, sink, external=external, hello_timeout_s=wait_s, taps=taps, changes=changes
        )
    except HilError:  # nothing ran: nothing is left behind
        sink.discard()
        raise
    except OSError as error:
        if error.errno not in (EMFILE, ENFILE) or sink.messages:
            raise
        sink.discard()
        raise HilError("no free file descriptor to start rig and controller; raise the limit: ulimit -n 64") from error
    sink.drop(real.pump.dropped)
    out: dict[str, Any] = {"torn_bytes": real.pump.torn_bytes}
    if real.controller_failed is not None:
        sink.event(real.controller_lost_ns, PLUG_IN_FAILED, real.controller_failed, severity="error")
    elif real.controller_lost:
        out["controller_lost"] = real.controller_lost
        sink.event(real.controller_lost_ns, "controller lost", real.controller_lost, severity="error")
    counts: dict[str, Any] = dict(real.controller_counts)
    if counts:
        sink.event(real.pump.last_ns, "controller ended", "what the controller and its end of the link counted", **counts)
    if real.controller_departed is not None:
        k, by = real.controller_departed
        message = f"certificate withdrawn: the controller left its table at slot {k} by {by}"
        sink.event(real.pump.last_ns, WITHDRAWN, message, tick=k, severity="error")
    unwanted = counts.get("refused", 0) + counts.get("contradicted", 0)
    if unwanted:
        out["controller_refused"] = f"the controller refused {unwanted} frames: they are not of this rig, or not of its slot"
    if real.interrupted is not None:
        out |= _interrupted(real.interrupted, sink, real.pump.last_ns)
    elif real.rig_silent is not None:
        out["rig_lost"] = real.rig_silent
        sink.event(real.pump.last_ns, "rig lost", real.rig_silent, severity="error")
    elif real.rig_status not in (ENDED, FAILED):
        out["rig_lost"] = (
            f"the rig process was killed by {signal.Signals(-real.rig_status).name}"
            if real.rig_status is not None and real.rig_status < 0
            else f"the rig process ended with status {real.rig_status}"
        )
        sink.event(real.pump.last_ns, "rig lost", out["rig_lost"], severity="error")
    return out


def _summary(run: Run, loop: Loop, sink: McapSink, outcome: dict[str, Any], wall_s: float) -> dict[str, Any]:
    failed: dict[str, str] = {}
    summary: dict[str, Any] = summarise(view_of(run, loop.experiment, loop.rig), failed)
    if failed:
        outcome["measure_failed"] = "; ".join(failed.values())
    summary["wall_s"] = round(wall_s, 3)
    summary["log"] = {
        "path": str(sink.path),
        "sha256": "",
        "messages": sink.messages,
        "dropped": sink.dropped,
    }
    problems = _told(run, {*INTRUSIONS, PLANT_FAILED, PLUG_IN_FAILED, WITHDRAWN, DEPARTED})
    summary["link_counters"] = link_counters(run)
    summary["controller_counters"] = controller_counters(run)
    refused = (summary["link_counters"] or {}).get("refused", 0)
    if refused:
        problems["refused"] = f"{refused} packets or peers on the link were refused: they had not the key or the name"
    summary["problems"] = problems | {name: text for name, text in outcome.items() if text}
    return summary


def _kinds(run: Run) -> set[str]:
    return {event["kind"] for event in run.events}


def _told(run: Run, kinds: Collection[str]) -> dict[str, Any]:
    """Return what the events of some kinds say, by kind."""
    return {event["kind"].replace(" ", "_"): event["message"] for event in run.events if event["kind"] in kinds}


def link_counters(run: Run) -> dict[str, int] | None:
    """Return what the rig's end of the link counted, None where there was no link or the rig did not end in order."""
    said = [event["data"]["link"] for event in run.events if event["kind"] == "outcome" and "link" in event.get("data", {})]
    return {name: int(value) for name, value in said[0].items()} if said else None


def controller_counters(run: Run) -> dict[str, int] | None:
    """Return what our controller and its end of the link counted, None where it did not end in order, or was not ours."""
    said = [event["data"] for event in run.events if event["kind"] == "controller ended" and "data" in event]
    return {name: int(value) for name, value in said[0].items()} if said else None


def _status(run: Run, sink: McapSink, outcome: dict[str, Any]) -> int:
    if "interrupted" in outcome:
        return 128 + int(signal.Signals[outcome["interrupted"]])
    kinds = _kinds(run)
    if outcome.keys() & {"rig_lost", "log_lost", "measure_failed"} or kinds & {PLANT_FAILED, PLUG_IN_FAILED} or sink.error:
        return 1
    if "second controller" in kinds:
        return INTRUSIONS["second controller"]  # whatever it led to: the run is not that of our controller
    if kinds & {WITHDRAWN, DEPARTED}:
        return LEFT
    return 3 if "safety" in kinds else INTRUSIONS["flood"] if "flood" in kinds else 0
