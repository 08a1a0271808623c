"""One run with what every number and every picture of it needs: made once, read by all."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, Literal, TypeVar

import numpy as np
import numpy.typing as npt
from msgspec import Struct, field
from msgspec.structs import replace

from hil.errors import HilError
from hil.experiment import Experiment, experiment_from_resolved
from hil.log import topics
from hil.log.append_column import pieces, release, whole
from hil.log.records import TIME_FIELD
from hil.log.run import Run
from hil.log.topics import inputs_among
from hil.measure.signals import Followed, Signals, bare, tracked_among
from hil.rig import RigSpec, rig_of
from plants.errors import PlantError

MEASUREMENT, REFERENCE = topics.MEASUREMENT.name, topics.REFERENCE.name
APPLIED, TIMING = topics.APPLIED.name, topics.TIMING.name
REFERENCE_STEP, DISTURBANCE = "reference step", "disturbance"

_BOOKKEEPING = ("started", "outcome", "stop", "stopped")

Severity = Literal["neutral", "warning", "error"]
_SEVERITIES: dict[str, Severity] = {"warning": "warning", "error": "error"}
Made = TypeVar("Made")


class Mark(Struct, frozen=True, kw_only=True):
    """Something that happened at an instant.

    Args:
        t_s: session time, s.
        label: what happened; empty for one of many late packets.
        severity: how bad it is.
    """

    t_s: float
    label: str
    severity: Severity = "neutral"


class RunView(Struct, frozen=True, kw_only=True, eq=False):
    """A run as measures and figures see it.

    Args:
        run: the log.
        experiment: what ran; None if it cannot be made again here (a plug-in is gone).
        period_s: sample period, s.
        signals: outputs, tracked outputs and inputs, with their units.
        marks: what happened when: reference steps, disturbances, events, late packets.
        known_rig: the rig of the composed loop that ran, where it is known.
    """

    run: Run
    experiment: Experiment | None
    period_s: float
    signals: Signals
    marks: tuple[Mark, ...]
    known_rig: RigSpec | None = None
    _made: dict[Any, Any] = field(default_factory=dict)

    def once(self, make: Callable[[RunView], Made]) -> Made:
        """Return what a function makes of this run; it is called once for this view and its single outputs.

        Args:
            make: reads the run and the experiment, not which outputs are tracked.
        """
        if make not in self._made:
            self._made[make] = make(self)
        found: Made = self._made[make]
        return found

    @property
    def rig(self) -> RigSpec | None:
        """The rig that ran, None where its experiment cannot be made again here."""
        return self.once(_rig)

    def unit(self, topic: str, name: str) -> str:
        """Return the unit that the schema states for a field, nothing for a pure number."""
        return _unit(self.run, topic, name)

    def only(self, name: str) -> RunView:
        """Return the same run with one tracked output."""
        return replace(self, signals=self.signals.only(name))

    def without_records(self) -> RunView:
        """Return a run as if it had ended at once."""
        return self.of(replace(self.run, arrays={name: a[:0] for name, a in self.run.arrays.items()}, events=[]))

    def of(self, run: Run) -> RunView:
        """Return the view of a run with other records of the same experiment."""
        return replace(self, run=run, _made={})

    def disturbed_at_s(self) -> float | None:
        """Return when the first input disturbance began as the experiment states it, s; None without one."""
        if self.experiment is not None:
            return min((float(p.at) for p in self.experiment.disturbance), default=None)
        return min((float(p["at"]) for p in self.run.resolved.get("disturbance", [])), default=None)

    def tracking(self) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Return times in s (n,), tracked outputs (n, p) and their reference (n, p), of the slots that have both."""
        whole_run = self.followed()
        return whole_run.of(0, whole_run.slots)

    def followed(self) -> Followed:
        """Return the same, to be read in blocks."""
        names = list(self.signals.tracked)
        measurement, reference = self._paired()

        def of(i: int, j: int) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], npt.NDArray[np.float64]]:
            y, r = measurement[i:j], reference[i:j]
            found = seconds(y), matrix(y, names), matrix(r, names)
            release(measurement)
            release(reference)
            return found

        return Followed(slots=len(measurement), of=of)

    def _paired(self) -> tuple[npt.NDArray[np.void], npt.NDArray[np.void]]:
        measurement, reference = self.run.arrays[MEASUREMENT], self.run.arrays[REFERENCE]
        if _same_slots(measurement, reference):
            return measurement, reference
        # A torn log may hold a sample without its reference: what belongs together has one slot.
        _, i, j = np.intersect1d(measurement["slot"], reference["slot"], assume_unique=True, return_indices=True)
        return measurement[i], reference[j]

    def applied(self) -> npt.NDArray[np.float64]:
        """Return the inputs that were applied, (n, m), without the disturbances."""
        return matrix(self.run.arrays[APPLIED], list(self.signals.inputs))

    def inputs(self) -> Iterator[npt.NDArray[np.float64]]:
        """Give the same in blocks."""
        for piece in pieces(self.run.arrays[APPLIED]):
            yield matrix(piece, list(self.signals.inputs))


def _same_slots(a: npt.NDArray[np.void], b: npt.NDArray[np.void]) -> bool:
    """Return whether two series of records have the same slots, each once and in order."""
    last = -1
    if len(a) != len(b):
        return False
    for one, other in zip(pieces(a), pieces(b)):
        slots = one["slot"]
        if not np.array_equal(slots, other["slot"]) or (slots[1:] <= slots[:-1]).any() or slots[0] <= last:
            return False
        last = slots[-1]
    return True


def _rig(view: RunView) -> RigSpec | None:
    if view.known_rig is not None or view.experiment is None:
        return view.known_rig
    try:
        return rig_of(view.experiment)
    except (HilError, PlantError):
        return None


def view_of(run: Run, experiment: Experiment | None = None, rig: RigSpec | None = None) -> RunView:
    """Return the view of a run.

    Args:
        run: a log that was read, or a run kept in memory with the topics `/plant/measurement`, `/reference` and
            `/actuator/applied`.
        experiment: what ran, where it is known; else it is made again from what the log carries, once.
        rig: of the composed loop that ran, where it is known.
    """
    known = experiment if experiment is not None else _experiment_of(run)
    outputs = {name: _unit(run, MEASUREMENT, name) for name in signal_names(run, MEASUREMENT)}
    signals = Signals(
        outputs=outputs,
        inputs={name: _unit(run, APPLIED, name) for name in signal_names(run, APPLIED)},
        tracked=tracked_among(known.plant if known is not None else None, outputs),
    )
    return RunView(run=run, experiment=known, period_s=_period_of(run, known), signals=signals, marks=_marks(run), known_rig=rig)


def seconds(array: npt.NDArray[np.void]) -> npt.NDArray[np.float64]:
    """Return the session time of every record, s."""
    return np.asarray(whole(array, TIME_FIELD) / 1e9, dtype=np.float64)


def signal_names(run: Run, topic: str) -> list[str]:
    """Return the float fields of a topic that are signals (for the actuator: the inputs, not the disturbances)."""
    if topic not in run.arrays:
        return []
    array = run.arrays[topic]
    return inputs_among([n for n in array.dtype.names or () if array.dtype[n].kind == "f"])


def matrix(array: npt.NDArray[np.void], names: list[str]) -> npt.NDArray[np.float64]:
    """Return fields of a structured array as one array (n, len(names))."""
    out, at = np.empty((len(array), len(names))), 0
    for piece in pieces(array):
        for column, name in zip(out[at : at + len(piece)].T, names):
            column[:] = piece[name]
        at += len(piece)
    return out


def _unit(run: Run, topic: str, name: str) -> str:
    schema = run.schemas.get(topic)
    return bare(next((f.unit for f in schema.fields if f.name == name), "")) if schema is not None else ""


def _experiment_of(run: Run) -> Experiment | None:
    """Return the experiment that ran, None if it cannot be made again here (a plug-in is gone)."""
    try:
        return experiment_from_resolved(run.resolved, run.experiment_text, "log") if run.resolved else None
    except HilError:
        return None


def _period_of(run: Run, experiment: Experiment | None) -> float:
    """Return the sample period in s, as the experiment or the log states it, or else as the records are spaced."""
    if experiment is not None:
        return float(experiment.period)
    if "period" in run.resolved:
        return float(run.resolved["period"])
    times = run.arrays[MEASUREMENT][TIME_FIELD] if MEASUREMENT in run.arrays else np.zeros(0)
    return float(np.median(np.diff(times))) / 1e9 if len(times) > 1 else 1.0


def _marks(run: Run) -> tuple[Mark, ...]:
    found = [Mark(t_s=t, label=REFERENCE_STEP) for t in _reference_steps(run)]
    applied = run.arrays.get(APPLIED)
    disturbances = [] if applied is None else [n for n in applied.dtype.names or () if n.startswith("w_")]
    if applied is not None and disturbances:
        before = False
        for piece in pieces(applied):
            active = np.logical_or.reduce([piece[name] != 0.0 for name in disturbances])
            begins = np.flatnonzero(active & ~np.concatenate(([before], active[:-1])))
            found += [Mark(t_s=float(t), label=DISTURBANCE) for t in seconds(piece[begins])]
            before = bool(active[-1])
    for event in run.events:
        if event.get("kind") not in _BOOKKEEPING:
            severity = _SEVERITIES.get(event.get("severity", ""), "neutral")
            found.append(Mark(t_s=float(event.get("t_s", 0.0)), label=str(event.get("kind", "event")), severity=severity))
    timing = run.arrays.get(TIMING)
    if timing is not None:
        named = {m.t_s for m in found if m.label == "late"}
        late = [t for piece in pieces(timing) for t in seconds(piece[piece["late"] != 0]).tolist()]
        found += [Mark(t_s=t, label="", severity="warning") for t in late if t not in named]
    return tuple(found)


def _reference_steps(run: Run) -> list[float]:
    """Return the times at which the reference changed, s."""
    if REFERENCE not in run.arrays:
        return []
    array, names = run.arrays[REFERENCE], signal_names(run, REFERENCE)
    found: list[float] = []
    before = np.empty((0, len(names)))
    for piece in pieces(array):
        rows = np.concatenate((before, matrix(piece, names)))
        changed = np.flatnonzero(np.any(rows[1:] != rows[:-1], axis=1)) + 1 - len(before)
        found += seconds(piece[changed]).tolist()
        before = rows[-1:]
    return found
