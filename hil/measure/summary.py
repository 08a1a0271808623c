"""The summary of a run: what `hil run --json` prints, computed from the log alone."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from hil.errors import HilError
from hil.experiment import Experiment, experiment_from_resolved
from hil.log.read.run import Run
from hil.log.records import TIME_FIELD
from hil.measure.network import network_metrics
from hil.measure.timing import timing_metrics
from hil.measure.tracking import tracking_metrics
from transport.medium.draws import REASONS


def summarise(run: Run) -> dict[str, Any]:
    """Return the summary of a run as plain JSON values.

    Keys: experiment, seed, clock, link, ticks, duration_s; metrics (see `tracking_metrics`; for more than one output
    also `outputs`, the same per output); network.sc and network.ca (see `network_metrics`); timing (see
    `timing_metrics`, with `scheduler`); safety (the reason why safety stopped the run, or None); certificate (mean
    square radius and verdict, or None).

    Args:
        run: a log that was read, or a run kept in memory with `metadata` and `resolved`.
    """
    experiment = experiment_of(run)
    period_s = period_of(run)
    ticks = _ticks(run)
    timing = run.arrays.get("/timing/tick")
    timing = timing if timing is not None and len(timing) else None
    measured = run_timing(run)
    links = run.resolved.get("links", {})
    reasons = run.codes.get("reason") or REASONS
    network = {}
    for side in ("sc", "ca"):
        law = getattr(experiment.links, side).law if experiment is not None else None
        kind = str(links.get(side, {}).get("law", {}).get("kind", "?"))
        late = measured["late"] if side == "ca" else 0
        network[side] = network_metrics(run.arrays.get(f"/network/{side}"), law, kind, late=late, reasons=reasons)
    return {
        "experiment": run.metadata.get("experiment", ""),
        "seed": int(run.metadata.get("seed", 0)),
        "clock": run.metadata.get("clock", ""),
        "link": run.metadata.get("link", ""),
        "ticks": ticks,
        "duration_s": round(ticks * period_s, 9),
        "metrics": run_metrics(run, experiment),
        "network": network,
        "timing": measured,
        "safety": safety_of(run),
        "certificate": certificate_of(run),
    }


def run_metrics(run: Run, experiment: Experiment | None = None) -> dict[str, Any]:
    """Return the tracking metrics of a run; see `tracking_metrics`.

    Args:
        run: needs the topics `/plant/measurement`, `/reference` and `/actuator/applied`.
        experiment: what ran; None to take period and disturbances from `run.resolved`.
    """
    period_s = float(experiment.period) if experiment is not None else period_of(run)
    pulses = (
        [float(p.at) for p in experiment.disturbance]
        if experiment is not None
        else [float(p["at"]) for p in run.resolved.get("disturbance", [])]
    )
    disturbed = min(pulses, default=None)
    measurement, reference = run.arrays["/plant/measurement"], run.arrays["/reference"]
    # A torn log may hold a sample without its reference: what belongs together has one tick.
    _, i, j = np.intersect1d(measurement["tick"], reference["tick"], assume_unique=True, return_indices=True)
    names = tracked_names(run, experiment)
    t = measurement[TIME_FIELD][i] / 1e9
    y, r = matrix(measurement, names)[i], matrix(reference, names)[j]
    applied = run.arrays["/actuator/applied"]
    u = matrix(applied, signal_names(run, "/actuator/applied"))
    found: dict[str, Any] = dict(tracking_metrics(t, y, r, u, period_s, disturbed_at_s=disturbed))
    if len(names) > 1:
        found["outputs"] = {
            name: {
                key: value
                for key, value in tracking_metrics(t, y[:, c], r[:, c], u, period_s, disturbed_at_s=disturbed).items()
                if key != "max_abs_u"
            }
            for c, name in enumerate(names)
        }
    return found


def tracked_names(run: Run, experiment: Experiment | None) -> list[str]:
    """Return the outputs that shall follow the reference: all, unless the plant names them (a measured mode does not)."""
    names = signal_names(run, "/plant/measurement")
    tracked = getattr(experiment.plant, "tracked", names) if experiment is not None else names
    return [name for name in names if name in tracked]


def run_timing(run: Run) -> dict[str, Any]:
    """Return the timing metrics of a run; see `timing_metrics`."""
    ticks = run.arrays.get("/timing/tick")
    empty = np.zeros(0)
    columns = [empty] * 4 if ticks is None else [ticks[n] for n in ("lateness_us", "round_trip_us", "late", "overrun")]
    found = timing_metrics(*columns, period_s=period_of(run))
    if found["first_late_tick"] is not None and ticks is not None:
        found["first_late_tick"] = int(ticks["tick"][found["first_late_tick"]])
    if run.metadata.get("clock") == "real" and (ticks is None or not len(ticks)):
        found |= {"valid": False, "why": ["no slot was timed"]}
    said = [e["data"]["scheduler"] for e in run.events if "scheduler" in e.get("data", {})]
    found["scheduler"] = str(said[0]) if said else ("virtual time" if run.metadata.get("clock") == "virtual" else None)
    return found


def safety_of(run: Run) -> str | None:
    """Return why safety stopped the run, None if it did not."""
    return next((str(e["message"]) for e in run.events if e.get("kind") == "safety"), None)


def certificate_of(run: Run) -> dict[str, Any] | None:
    """Return what the design's certificate says of stability, None if the loop has none."""
    return dict(run.certificate) if run.certificate else None


def experiment_of(run: Run) -> Experiment | None:
    """Return the experiment that ran, None if it cannot be made again here (a plug-in is gone)."""
    try:
        return experiment_from_resolved(run.resolved, run.experiment_text, "log") if run.resolved else None
    except HilError:
        return None


def period_of(run: Run) -> float:
    """Return the sample period in s, as resolved, or else as the records are spaced."""
    if "period" in run.resolved:
        return float(run.resolved["period"])
    times = run.arrays["/plant/measurement"][TIME_FIELD]
    return float(np.median(np.diff(times))) / 1e9 if len(times) > 1 else 1.0


def signal_names(run: Run, topic: str) -> list[str]:
    """Return the float fields of a topic that are signals (for the actuator: the inputs, not the disturbances).

    For `/actuator/applied` a field `w_x` stands beside every `x`.
    """
    array = run.arrays[topic]
    names = [n for n in array.dtype.names or () if array.dtype[n].kind == "f"]
    return [n for n in names if not (n.startswith("w_") and n[2:] in names)]


def matrix(array: npt.NDArray[np.void], names: list[str]) -> npt.NDArray[np.float64]:
    """Return fields of a structured array as one array (n, len(names))."""
    return np.column_stack([array[n] for n in names]).astype(np.float64) if names else np.zeros((len(array), 0))


def _ticks(run: Run) -> int:
    ticks = run.arrays["/plant/measurement"]["tick"]
    return int(ticks[-1]) + 1 if len(ticks) else 0
