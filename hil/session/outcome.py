"""What a log says of its run when it is over: the summary, the problems, and the exit status."""

from __future__ import annotations

import json
import signal
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any, Final

from hil.log.events import DEPARTED, PLANT_FAILED, PLUG_IN_FAILED, WITHDRAWN, decode_event, to_json
from hil.log.run import Run
from hil.log.topics import BUS, CA, SC, channels_of
from hil.log.write.mcap_sink import McapSink
from hil.log.write.provenance import Provenance
from hil.measure.measure import measures_of
from hil.measure.summary import summarise
from hil.measure.view import APPLIED, MEASUREMENT, REFERENCE, TIMING, view_of
from hil.rig.loop import Loop

LEFT: Final = 7
"""Exit status where a plant or a controller was not, in the run, what it says that it is."""

INTRUSIONS: Final = {"second controller": 5, "flood": 6}
"""Exit statuses by the events that say that another process sends on the link."""


def summary_needs(loop: Loop) -> dict[str, Sequence[str] | None] | None:
    """Return what a summary needs of a log in virtual time, topic to fields (None: all); None where it needs raw frames."""
    table = channels_of(loop)
    keep: dict[str, Sequence[str] | None] = dict.fromkeys((MEASUREMENT, REFERENCE, APPLIED, TIMING))
    for topic, laws in ((SC.name, loop.rig.laws[:-1]), (CA.name, loop.rig.laws[-1:])):
        counted = [name for name in table[topic].schema.dtype.names or () if name in ("mode", "node", "reason")]
        keep[topic] = counted if all(law.family == "age" for law in laws) else None
    wanted = {topic for measure in measures_of(loop.experiment) for topic in measure.topics}
    keep |= dict.fromkeys((wanted | {BUS.name}) & table.keys())
    return None if any(table[topic].schema.raw for topic in keep) else keep


def kept_run(sink: McapSink, provenance: Provenance) -> Run:
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


def read_back(path: Path, *, whole: bool = True, descriptor: int | None = None) -> Run:
    from hil.log.read.run import read_run  # a run in virtual time keeps its columns, and reads no log

    return read_run(path, whole=whole, descriptor=descriptor)


def summary_of(run: Run, loop: Loop, sink: McapSink, outcome: dict[str, Any], wall_s: float) -> dict[str, Any]:
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
    problems = messages_of(run, {*INTRUSIONS, PLANT_FAILED, PLUG_IN_FAILED, WITHDRAWN, DEPARTED})
    summary["link_counters"] = link_counters(run)
    summary["controller_counters"] = controller_counters(run)
    refused = (summary["link_counters"] or {}).get("refused", 0)
    if refused:
        problems["refused"] = f"{refused} packets or peers on the link were refused: they had not the key or the name"
    summary["problems"] = problems | {name: text for name, text in outcome.items() if text}
    return summary


def unreached(loop: Loop) -> dict[str, str]:
    return {"faults": loop.rig.unreached} if loop.rig.unreached else {}


def gains_in(loop: Loop) -> dict[str, Any]:
    return {"gains": None if loop.gains is None else loop.gains.to_json()}


def kinds_of(run: Run) -> set[str]:
    return {event["kind"] for event in run.events}


def messages_of(run: Run, kinds: Collection[str]) -> dict[str, Any]:
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


def status_of(run: Run, sink: McapSink, outcome: dict[str, Any]) -> int:
    if "interrupted" in outcome:
        return 128 + int(signal.Signals[outcome["interrupted"]])
    kinds = kinds_of(run)
    if outcome.keys() & {"rig_lost", "log_lost", "measure_failed"} or kinds & {PLANT_FAILED, PLUG_IN_FAILED} or sink.error:
        return 1
    if "second controller" in kinds:
        return INTRUSIONS["second controller"]  # whatever it led to: the run is not that of our controller
    if kinds & {WITHDRAWN, DEPARTED}:
        return LEFT
    return 3 if "safety" in kinds else INTRUSIONS["flood"] if "flood" in kinds else 0
