"""The result of a run: its log, its summary with problems and exit status, and its presentation in a notebook and in a paper."""

from __future__ import annotations

import json
import signal
from collections.abc import Collection, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from msgspec import Struct, to_builtins
from msgspec.structs import force_setattr

from hil.errors import HilError
from hil.experiment import Experiment
from hil.log import DEPARTED, PLANT_FAILED, PLUG_IN_FAILED, REFUSED, WITHDRAWN, decode_event, to_json
from hil.log.records import TIME_FIELD
from hil.log.run import Run, StructuredArray
from hil.log.topics import BUS, CA, SC, channels_of
from hil.log.write.mcap_sink import McapSink
from hil.log.write.provenance import Provenance
from hil.measure import Named, in_one_row, measures_of
from hil.measure.signals import with_unit
from hil.measure.summary import summarise
from hil.measure.view import APPLIED, MEASUREMENT, REFERENCE, TIMING, seconds, view_of
from hil.rig.loop import Loop

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure


LEFT: Final = 7
"""Exit status where plant or controller departed, in the run, from what it states."""

INTRUSIONS: Final = {"second controller": 5, "flood": 6}
"""Exit statuses by the events that say that another process sends on the link."""


class Session(Struct, frozen=True, kw_only=True, eq=False):
    """The result of a run.

    Args:
        log: its log, or the file, which is read when it is first asked for.
        summary: what ``hil run --json`` prints.
        status: exit status: 0, 1 the rig died or the log is not whole, 3 stopped by safety,
            5 a second controller answered too, 6 the link was flooded, 7 plant or controller departed from what it states,
            128 + N ended by signal N.
        experiment: what ran.
    """

    log: Run | Path
    summary: dict[str, Any]
    status: int
    experiment: Experiment | None = None

    def __post_init__(self) -> None:
        force_setattr(self, "summary", Named("part of the summary", self.summary))

    @property
    def run(self) -> Run:
        """The log, read back; it takes memory for every record."""
        run = self.log if isinstance(self.log, Run) else read_back(self.log)
        force_setattr(self, "log", run)
        return run

    @property
    def metrics(self) -> dict[str, Any]:
        """The numbers of the experiment's measures, by name; ``summary["titles"]`` and ``summary["units"]`` say what they are."""
        return Named("metric", self.summary["metrics"])

    @property
    def arrays(self) -> Mapping[str, StructuredArray]:
        """Topic to records, a structured numpy array each; field ``t_ns`` is the session time."""
        return self.run.arrays

    def to_pandas(self) -> dict[str, pandas.DataFrame]:
        """Return a `pandas.DataFrame` per topic, with the session time in s as its index and the units in ``attrs``.

        Raises:
            HilError: if pandas is not installed.
        """
        from hil.notebook import data_frame

        found = {}
        for topic, array in self.arrays.items():
            columns = {name: array[name] for name in array.dtype.names or () if name != TIME_FIELD}
            found[topic] = data_frame({"t_s": seconds(array), **columns}, _units(self.run, topic)).set_index("t_s")
        return found

    def to_xarray(self) -> dict[str, xarray.Dataset]:
        """Return an `xarray.Dataset` per topic over the coordinate ``t_s``, in s, with the unit of every variable.

        Raises:
            HilError: if xarray is not installed.
        """
        try:
            import xarray
        except ImportError as error:
            raise HilError("to_xarray: xarray is not installed; pip install 'hilrig[notebook]'") from error

        found = {}
        for topic, array in self.arrays.items():
            units = _units(self.run, topic)
            variables = {
                name: ("t_s", array[name], {"units": units.get(name, "")})
                for name in array.dtype.names or () if name != TIME_FIELD
            }  # fmt: skip
            found[topic] = xarray.Dataset(variables, coords={"t_s": ("t_s", seconds(array), {"units": "s"})})
        return found

    def plot(self, path: str | Path | None = None, *, width_mm: float = 85.0, height_mm: float | None = None) -> Figure:
        """Return a figure of the tracked outputs against their reference, and of the inputs, one above the other.

        Args:
            path: where to write it; its ending says how: .svg, .pdf or .png (300 dots per inch).
            width_mm, height_mm: of the figure as it is printed; 85 mm is a column of many journals. By default it is as high
                as its plots need.

        Raises:
            HilError: if matplotlib is not installed, or for another ending.
        """
        from hil.notebook import drawn

        run = self.run
        return drawn(partial(_paint, run), path, width_mm, _height_mm(run) if height_mm is None else height_mm)

    def _repr_html_(self) -> str:
        """Return the session in one line, its numbers, and the plot where matplotlib is installed."""
        from hil.notebook import Result

        run, titles, units = self.run, self.summary["titles"], self.summary["units"]
        found = in_one_row(self.summary["metrics"]).items()
        rows: list[tuple[str, float]] = [(with_unit(titles[k], units[k]), v) for k, v in found if isinstance(v, float)]
        result = Result(line=repr(self)[1:-1], columns=("quantity", "value"), rows=rows, paint=partial(_paint, run))
        return result.html(max(90.0, _height_mm(run)))

    def __repr__(self) -> str:
        s, metrics = self.summary, self.summary["metrics"]
        number, value = next(((k, v) for k, v in metrics.items() if isinstance(v, float)), ("", None))
        value_text = "" if value is None else f", {s['titles'][number]} {value:.5g} {s['units'][number]}".rstrip()
        safety = ", stopped by safety" if s.get("safety") else ""
        return f"<Session {s['experiment']} seed {s['seed']}, {s['clock']} time, {s['slots']} slots{value_text}{safety}>"


def _paint(run: Run, sheet: Figure) -> None:
    from hil.notebook import literal

    view = view_of(run)
    measurement, reference, applied = (run.arrays[topic] for topic in (MEASUREMENT, REFERENCE, APPLIED))
    outputs, inputs = view.signals.tracked, [*view.signals.inputs]
    followed = any(reference[name].any() for name in outputs)
    rows = sheet.subplots(len(outputs) + 1, 1, sharex=True, squeeze=False)[:, 0]
    for axis, name in zip(rows, outputs):
        if followed:
            axis.step(seconds(reference), reference[name], "--", where="post", color="0.45", label="reference")
        axis.plot(seconds(measurement), measurement[name], color="C0", label=name if len(outputs) == 1 else "output")
        axis.set_ylabel(literal(with_unit(name, view.signals.outputs[name])))
    if followed:
        rows[0].legend()
    unit = view.signals.input_unit()
    for number, name in enumerate(inputs):
        label = name if unit is not None else literal(with_unit(name, view.signals.inputs[name]))
        rows[-1].step(seconds(applied), applied[name], where="post", color=f"C{number + 1}", label=label)
    rows[-1].set_ylabel(literal(with_unit(inputs[0] if len(inputs) == 1 else "input", unit or "")))
    if len(inputs) > 1:
        rows[-1].legend()
    rows[-1].set_xlabel("time (s)")
    sheet.align_ylabels(rows)


def _height_mm(run: Run) -> float:
    return max(70.0, 30.0 * (len(view_of(run).signals.tracked) + 1))


def _units(run: Run, topic: str) -> dict[str, str]:
    schema = run.schemas.get(topic)
    return {f.name: f.unit for f in schema.fields} if schema is not None else {}


def summary_needs(loop: Loop) -> dict[str, Sequence[str] | None] | None:
    """Return the topics and fields (None: all) of a log that a summary in virtual time reads; None where it reads raw frames."""
    table = channels_of(loop)
    keep: dict[str, Sequence[str] | None] = dict.fromkeys((MEASUREMENT, REFERENCE, APPLIED, TIMING))
    for topic, laws in ((SC.name, loop.rig.laws[:-1]), (CA.name, loop.rig.laws[-1:])):
        counted = [name for name in table[topic].schema.dtype.names or () if name in ("mode", "node", "reason")]
        keep[topic] = counted if all(law.family == "age" for law in laws) else None
    wanted = {topic for measure in measures_of(loop.experiment) for topic in measure.topics}
    keep |= dict.fromkeys((wanted | {BUS.name}) & table.keys())
    return None if any(table[topic].schema.raw for topic in keep) else keep


def kept_run(sink: McapSink, provenance: Provenance) -> Run:
    """Return the run with the records that were kept in memory, equal to those of the log."""
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
    from hil.log.read import read_run  # a run in virtual time keeps its columns, and reads no log

    return read_run(path, whole=whole, descriptor=descriptor)


def summary_of(run: Run, loop: Loop, sink: McapSink, outcome: dict[str, Any], wall_s: float) -> dict[str, Any]:
    failed: dict[str, str] = {}
    summary: dict[str, Any] = summarise(view_of(run, loop.experiment, loop.rig), failed)
    if failed:
        outcome["measure_failed"] = "; ".join(failed.values())
    summary["wall_s"] = round(wall_s, 3)
    summary["log"] = {"path": str(sink.path), "sha256": "", "messages": sink.messages, "dropped": sink.dropped}
    problems = messages_of(run, {*INTRUSIONS, PLANT_FAILED, PLUG_IN_FAILED, REFUSED, WITHDRAWN, DEPARTED})
    summary["link_counters"] = link_counters(run)
    summary["controller_counters"] = controller_counters(run)
    problems |= not_admitted(summary["link_counters"] or {})
    summary["problems"] = problems | {name: text for name, text in outcome.items() if text}
    return summary


NOT_ADMITTED: Final = {
    "refused": "packets or peers on the link were refused: they lacked the key or the name",
    "turned_away": "times there was no room for a newcomer at the rig: too many are on the channel, or no descriptor was free",
    "unopened": "connections to the rig's endpoint said nothing, or nonsense, which delays the link where they are many",
}
"""Counters of a link that say that another participant tried to join or to command."""


def not_admitted(counters: Mapping[str, int]) -> dict[str, str]:
    return {name: f"{counters[name]} {what}" for name, what in NOT_ADMITTED.items() if counters.get(name)}


def unreached(loop: Loop) -> dict[str, str]:
    return {"faults": loop.rig.unreached} if loop.rig.unreached else {}


def gains_in(loop: Loop) -> dict[str, Any]:
    return {"gains": to_builtins(loop.gains)}


def kinds_of(run: Run) -> set[str]:
    return {event["kind"] for event in run.events}


def messages_of(run: Run, kinds: Collection[str]) -> dict[str, Any]:
    """Return the first message of the events of each of some kinds."""
    return {each["kind"].replace(" ", "_"): each["message"] for each in reversed(run.events) if each["kind"] in kinds}


def link_counters(run: Run) -> dict[str, int] | None:
    """Return what the rig's end of the link counted, None where there was no link or the rig did not end in order."""
    outcomes = [event["data"]["link"] for event in run.events if event["kind"] == "outcome" and "link" in event.get("data", {})]
    return {name: int(value) for name, value in outcomes[0].items()} if outcomes else None


def controller_counters(run: Run) -> dict[str, int] | None:
    """Return what our controller and its end of the link counted, None where it did not end in order, or was not ours."""
    outcomes = [event["data"] for event in run.events if event["kind"] == "controller ended" and "data" in event]
    return {name: int(value) for name, value in outcomes[0].items()} if outcomes else None


def status_of(run: Run, sink: McapSink, outcome: dict[str, Any]) -> int:
    if "interrupted" in outcome:
        return 128 + int(signal.Signals[outcome["interrupted"]])
    kinds = kinds_of(run)
    if outcome.keys() & {"rig_lost", "log_lost", "measure_failed"} or kinds & {PLANT_FAILED, PLUG_IN_FAILED} or sink.error:
        return 1
    if "second controller" in kinds:
        return INTRUSIONS["second controller"]  # before all later problems: the run is not that of our controller
    if kinds & {WITHDRAWN, DEPARTED}:
        return LEFT
    return 3 if "safety" in kinds else INTRUSIONS["flood"] if "flood" in kinds else 0
