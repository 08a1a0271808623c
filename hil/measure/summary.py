"""The summary of a run: what `hil run --json` prints, computed from the log alone."""

from __future__ import annotations

from typing import Any

import numpy as np

from hil.experiment import Experiment
from hil.log.read.run import Run
from hil.measure.measure import measured, measures_of, quantities_of
from hil.measure.network import network_metrics
from hil.measure.network_load import node_metrics, several_nodes
from hil.measure.timing import timing_metrics
from hil.measure.view import MEASUREMENT, TIMING, RunView, view_of
from transport.medium.draws import REASONS


def summarise(view: RunView) -> dict[str, Any]:
    """Return the summary of a run as plain JSON values.

    Keys: experiment, seed, clock, link, ticks, duration_s; metrics (the numbers of the experiment's measures, see
    `hil.measure.measure.measured`) and units (of them, nothing for a pure number); network.sc and network.ca (see
    `network_metrics`); timing (see `timing_metrics`, with `scheduler`); safety (the reason why safety stopped the run, or
    None); network.nodes (where nodes are named: the same per node, and its load); certificate (what the log carries of it,
    or None).

    Args:
        view: a log that was read, or a run kept in memory with `metadata` and `resolved`.
    """
    run, experiment = view.run, view.experiment
    ticks = _ticks(run)
    timing = run_timing(view)
    links = run.resolved.get("links", {})
    reasons = run.codes.get("reason") or REASONS
    laws = laws_of(experiment)
    network = {}
    for side in ("sc", "ca"):
        kind = str(links.get(side, {}).get("law", {}).get("kind", "?"))
        late = timing["late"] if side == "ca" else 0
        network[side] = network_metrics(run.arrays.get(f"/network/{side}"), laws[side], kind, late=late, reasons=reasons)
    if experiment is not None and experiment.nodes:
        network["sc"] = several_nodes(network["sc"])
        network["nodes"] = node_metrics(view, reasons)
    measures = measures_of(experiment)
    return {
        "experiment": run.metadata.get("experiment", ""),
        "seed": int(run.metadata.get("seed", 0)),
        "clock": run.metadata.get("clock", ""),
        "link": run.metadata.get("link", ""),
        "ticks": ticks,
        "duration_s": round(ticks * view.period_s, 9),
        "metrics": measured(view, measures),
        "units": {q.name: q.unit for q in quantities_of(measures, view.signals)},
        "network": network,
        "timing": timing,
        "safety": safety_of(run),
        "certificate": dict(run.certificate) if run.certificate else None,
    }


def laws_of(experiment: Experiment | None) -> dict[str, Any]:
    """Return the network law of each direction, None where the experiment cannot be made again here."""
    if experiment is None:
        return {"sc": None, "ca": None}
    return {"sc": experiment.links.sc.law, "ca": experiment.links.ca.law}


def run_metrics(run: Run, experiment: Experiment | None = None) -> dict[str, Any]:
    """Return the numbers of a run by name; see `hil.measure.measure.measured`.

    Args:
        run: needs the topics `/plant/measurement`, `/reference` and `/actuator/applied`.
        experiment: what ran, where it is known.
    """
    view = view_of(run, experiment)
    return measured(view, measures_of(view.experiment))


def run_timing(view: RunView) -> dict[str, Any]:
    """Return the timing metrics of a run; see `timing_metrics`."""
    run = view.run
    ticks = run.arrays.get(TIMING)
    empty = np.zeros(0)
    columns = [empty] * 4 if ticks is None else [ticks[n] for n in ("lateness_us", "round_trip_us", "late", "overrun")]
    found = timing_metrics(*columns, period_s=view.period_s)
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


def _ticks(run: Run) -> int:
    ticks = run.arrays[MEASUREMENT]["tick"]
    return int(ticks[-1]) + 1 if len(ticks) else 0
