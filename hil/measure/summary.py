"""The summary of a run: what `hil run --json` prints, computed from the log alone; and whether the rig kept its times.

The latter says whether the run can be believed.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
from msgspec.structs import asdict

from hil.experiment import Experiment
from hil.log import WITHDRAWN
from hil.log.run import Run
from hil.log.topics import BUS, SC
from hil.measure import each_output, measured, quantities_of, run_measures
from hil.measure.network_paths import changed_fields, law_kinds, loads, network_metrics, network_paths
from hil.measure.view import APPLIED, TIMING, RunView, view_of
from hil.rig import RigSpec
from hil.rig.schedules import SCHEDULES
from transport.draws import REASONS

Array: TypeAlias = npt.NDArray[Any]

OVERRUN_SHARE = 1e-3
"""Largest share of overruns in a valid run."""

LATE_SHARE = 1e-3
"""Largest share of slots without an answer in time in a valid run."""

LATENESS_SHARE = 0.1
"""Largest p99 lateness of a valid run, as a share of the period: a sampling instant is then known to a tenth of T."""

POINTS: Mapping[str, tuple[float, int]] = {"p50": (50, 1), "p99": (99, 100), "p99_9": (99.9, 1000), "max": (100, 1)}
"""Quantiles in per cent, and the fewest values of which each is one."""


def timing_metrics(lateness_us: Array, round_trip_us: Array, late: Array, overrun: Array, *, period_s: float) -> dict[str, Any]:
    """Return the timing part of a summary, with its verdict.

    A run is valid when at most 0.1 % of its slots overran, at most 0.1 % had no answer in time, and the p99 of the lateness (of
    fewer than 100 slots the largest) is at most a tenth of the period. A virtual run (no slots timed) is valid: its times are
    exact.

    Args:
        lateness_us: wake-up after the nominal time in us, (n,).
        round_trip_us: sensor frame out to control frame in, in us, (n,), NaN where none came.
        late, overrun: 0 or 1 (or counts) per slot, (n,).
        period_s: sample period in s.

    Returns:
        valid, why (the reasons against it), lateness_us and round_trip_us (p50, p99, p99_9, max; see `percentiles`), late,
        overruns, first_late_slot (index of the first slot that was late, None if none was).

    >>> timing_metrics(np.array([10.0, 12.0]), np.array([80.0, np.nan]), np.array([0, 1]), np.zeros(2), period_s=1e-3)["why"]
    ['1 of 2 slots had no answer in time']
    """
    n = len(lateness_us)
    late_count, overruns = int(np.sum(late)), int(np.sum(overrun))
    lateness = percentiles(lateness_us)
    why = []
    if n and late_count > LATE_SHARE * n:
        why.append(f"{late_count} of {n} slots had no answer in time")
    if n and overruns > OVERRUN_SHARE * n:
        why.append(f"{overruns} of {n} slots overran")
    name = "max" if lateness["p99"] is None else "p99"
    worst = lateness[name]
    if worst is not None and worst > LATENESS_SHARE * period_s * 1e6:
        why.append(f"{name} of the lateness is {worst:.0f} us, above a tenth of the period")
    missed = np.flatnonzero(late)
    return {
        "valid": not why,
        "why": why,
        "lateness_us": lateness,
        "round_trip_us": percentiles(round_trip_us),
        "late": late_count,
        "overruns": overruns,
        "first_late_slot": int(missed[0]) if missed.size else None,
    }


def percentiles(values: Array) -> dict[str, float | None]:
    """Return p50, p99, p99_9 and max of the finite values; None for what so few cannot show.

    A quantile is one of the sample where at least one value may lie beyond it: p99 of 100 values, p99_9 of 1000. Of fewer it
    would be the largest under another name.

    >>> percentiles(np.arange(1.0, 201.0))
    {'p50': 100.5, 'p99': 198.01, 'p99_9': None, 'max': 200.0}
    """
    finite = np.asarray(values, dtype=np.float64)
    finite = finite[np.isfinite(finite)]
    known = {name: point for name, (point, fewest) in POINTS.items() if finite.size >= fewest}
    found = np.percentile(finite, list(known.values())).tolist() if known else []
    return dict.fromkeys(POINTS) | dict(zip(known, found, strict=True))


def summarise(view: RunView, failed: dict[str, str] | None = None) -> dict[str, Any]:
    """Return the summary of a run as plain JSON values.

    Keys: experiment, seed, clock, link, controller (see `controller_of`), slots, duration_s; metrics (the numbers of the
    experiment's measures, see `hil.measure.measured`), titles (what people read of them) and units (nothing for a pure
    number), of single outputs under names such as ``sse.angle``; network.sc and network.ca (see `network_metrics`) and
    network.nodes (the same per sensor node, and its load; see `network_summary`), network.bus (where a CAN bus takes time; see
    `hil.measure.bus_load.BusLoad`); timing (see `timing_metrics`, with `scheduler`); safety (the reason why safety stopped the
    run, or None); certificate (what the log carries of it, or None).

    Args:
        view: a log that was read, or a run kept in memory with `metadata` and `resolved`.
        failed: takes what a measure raised; see `hil.measure.measured`.
    """
    run = view.run
    slots = _slots(run)
    timing = run_timing(view)
    measures = view.once(run_measures)
    quantities = quantities_of(measures, view.signals) + each_output(measures, view.signals)
    return {
        "experiment": run.metadata.get("experiment", ""),
        "seed": int(run.metadata.get("seed", 0)),
        "clock": run.metadata.get("clock", ""),
        "link": run.metadata.get("link", ""),
        "controller": controller_of(run),
        "slots": slots,
        "duration_s": round(slots * view.period_s, 9),
        "metrics": measured(view, measures, failed),
        "titles": {q.name: q.title for q in quantities},
        "units": {q.name: q.unit for q in quantities},
        "network": network_summary(view, timing["late"]) | _bus(view),
        "timing": timing,
        "safety": safety_of(run),
        "certificate": certificate_of(run),
    }


def certificate_of(run: Run) -> dict[str, Any] | None:
    """Return the certificate of a run, None without one.

    Undecided where the run itself showed what it rests on to be untrue. Of a run that was changed it is that of all that ran.
    """
    if not run.certificate:
        return None
    reason, found = withdrawal(run), claimed_to_the_end(run)
    return found if reason is None else {
        **found, "state": "undecided", "reason": reason, "stable": False, "stated": found["reason"],
    }  # fmt: skip


def claimed_to_the_end(run: Run) -> dict[str, Any]:
    """Return the certificate of a run as that of all that ran: with the first change behind which less is claimed.

    Args:
        run: with a certificate.
    """
    found, changes = dict(run.certificate), changed_fields(run)
    if found.get("state") != "certified":
        return found
    lost = next((each for each in changes if each.certificate.get("state") != "certified"), None)
    if lost is None:
        times = sum(each.path not in SCHEDULES for each in changes)
        often = "once, and certified again" if times == 1 else f"{times} times, and certified each time"
        began = f"when the run began: {found['reason']}; its loop was then changed {often}"
        return {**found, "reason": began} if times else found
    state, why = (str(lost.certificate.get(name, "undecided")) for name in ("state", "reason"))
    reason = f"certified until slot {lost.slot}, where {lost.path} was changed; then {why}"
    return {**found, "state": state, "stable": False, "stated": found["reason"], "reason": reason}


def withdrawal(run: Run) -> str | None:
    """Return why the certificate of a run was withdrawn, None if it was not."""
    return next((str(event["message"]) for event in run.events if event.get("kind") == WITHDRAWN), None)


def controller_of(run: Run) -> str:
    """Return who answered in a run: ``external``, or the kind of the experiment's controller."""
    if run.session.get("external_controller") == "True":
        return "external"
    return str(run.resolved.get("controller", {}).get("kind", ""))


def network_summary(view: RunView, late: int) -> dict[str, Any]:
    """Return the network part of a summary: sc and ca, see `network_metrics`, and nodes, the same per sensor node with its load.

    Where several nodes share the way to the controller, sc counts their packets together, and no law is tested: each has its own.
    `through` names medium and law in words.

    Args:
        view: the run.
        late: control packets that missed the deadline of their slot.
    """
    run = view.run
    reasons = run.codes.get("reason") or REASONS
    *sensors, actuator = view.once(network_paths)
    known = view.experiment
    slot = None if known is None else (view.period_s, known.timing.deadline * view.period_s)
    nodes = {
        path.node: {"through": path.through, **network_metrics(path.draws, path.law, path.kind, reasons=reasons, slot=slot)}
        for path in sensors
    }
    if len(sensors) == 1:
        together = nodes[sensors[0].node]
    else:
        kind = law_kinds(run)["sc"]
        counted = network_metrics(run.arrays.get(SC.name), None, kind, reasons=reasons)
        together = {**counted, "mode_counts": [], "transition_counts": [], "p_value": None}
    load = {each.node: asdict(each) for each in view.once(loads)}
    keys = ("packets", "packets_per_s", "bits_per_s")
    return {
        "sc": together,
        "ca": {
            "through": actuator.through,
            **network_metrics(actuator.draws, actuator.law, actuator.kind, late=late, reasons=reasons, slot=slot),
        },
        "nodes": {name: found | {key: load[name][key] for key in keys if name in load} for name, found in nodes.items()},
    }


def _bus(view: RunView) -> dict[str, Any]:
    if BUS.name not in view.run.arrays:
        return {}
    from hil.measure.bus_load import bus_of  # the analysis of a bus is loaded where there is one

    found = view.once(bus_of)
    return {} if found is None else {"bus": dataclasses.asdict(found)}


def run_metrics(run: Run, experiment: Experiment, rig: RigSpec) -> dict[str, Any]:
    """Return the numbers of a run by name; see `hil.measure.measured`.

    Args:
        run: needs the topics `/plant/measurement`, `/reference` and `/actuator/applied`.
        experiment: what ran.
        rig: of the loop that ran.
    """
    view = view_of(run, experiment, rig)
    return measured(view, view.once(run_measures))


def run_timing(view: RunView) -> dict[str, Any]:
    """Return the timing metrics of a run; see `timing_metrics`."""
    run = view.run
    timed = run.arrays.get(TIMING)
    empty = np.zeros(0)
    columns = [empty] * 4 if timed is None else [timed[n] for n in ("lateness_us", "round_trip_us", "late", "overrun")]
    found = timing_metrics(*columns, period_s=view.period_s)
    if found["first_late_slot"] is not None and timed is not None:
        found["first_late_slot"] = int(timed["slot"][found["first_late_slot"]])
    if run.metadata.get("clock") == "real" and (timed is None or not len(timed)):
        found |= {"valid": False, "why": ["no slot was timed"]}
    said = [e["data"]["scheduler"] for e in run.events if "scheduler" in e.get("data", {})]
    found["scheduler"] = str(said[0]) if said else ("virtual time" if run.metadata.get("clock") == "virtual" else None)
    return found


def safety_of(run: Run) -> str | None:
    """Return why safety stopped the run, None if it did not."""
    return next((str(e["message"]) for e in run.events if e.get("kind") == "safety"), None)


def _slots(run: Run) -> int:
    slots = run.arrays[APPLIED]["slot"]  # a slot that was cut off by a signal was measured, and nothing was applied
    return int(slots[-1]) + 1 if len(slots) else 0


def page_summary(view: RunView) -> dict[str, Any]:
    """Return the summary of a run, with what its log says of itself and of problems."""
    said: dict[str, Any] = {name: view.run.summary[name] for name in ("problems", "log") if name in view.run.summary}
    return {**summarise(view), **said}
