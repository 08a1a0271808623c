"""The report of one run: what `hil report` writes."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from hil.log.events import plain
from hil.log.read.run import Run
from hil.measure.summary import experiment_of, period_of, signal_names, tracked_names
from hil.measure.units import metric_units, with_unit
from hil.report.html.figures import Badge, Block, Cell, Section, Table, Text, Tile
from hil.report.html.numbers import text_of
from hil.report.html.page import render_page
from hil.report.run.statistics import network_blocks, network_table, timing_blocks
from hil.report.run.time_panels import (
    Prediction,
    delay_panels,
    input_panels,
    lateness_panel,
    markers,
    output_panels,
    reference_steps,
    state_panels,
    unit_of,
)

MOST_EVENTS = 300
STACKED = 2
"""Up to so many states and inputs stand below the outputs; more stand side by side."""


def render_report(
    run: Run,
    summary: Mapping[str, Any],
    *,
    predicted: Mapping[str, Prediction] | None = None,
    sections: Sequence[Section] = (),
) -> str:
    """Return the report of a run as one self-contained HTML page.

    Args:
        run: the log.
        summary: what `hil.measure.summary.summarise` says of it (with or without the parts `log` and `problems`).
        predicted: curves and bands of a theory, by output, drawn behind the run.
        sections: further sections, set before the experiment.
    """
    parts = [*run_sections(run, summary, predicted or {}), *sections, *_about(run)]
    description = str(run.resolved.get("description", ""))
    return render_page(
        str(summary["experiment"] or "Run"),
        parts,
        kicker="hilrig · run report",
        subtitle=description,
        badges=verdicts(run, summary),
        tiles=_tiles(run, summary["metrics"]),
        facts=_facts(run, summary),
        footer=f"Written by hilrig {run.versions.get('hilrig', '')} from the log alone. Drag across a plot to zoom all "
        "time axes, double-click to reset.",
    )


def run_sections(run: Run, summary: Mapping[str, Any], predicted: Mapping[str, Prediction]) -> list[Section]:
    """Return the sections that show what happened, in reading order; empty ones are left out."""
    marks = markers(run)
    experiment = experiment_of(run)
    laws = {side: getattr(experiment.links, side).law if experiment is not None else None for side in ("sc", "ca")}
    lateness = lateness_panel(run, marks)
    tables = _summary_tables(run, summary)
    outputs = output_panels(run, marks, predicted)
    inside: tuple[Block, ...] = (*state_panels(run, marks), *input_panels(run, marks))
    found = [
        Section(title="Tracking", blocks=(*outputs, *(inside if len(inside) <= STACKED else ()))),
        Section(title="States and inputs", columns=2, blocks=inside if len(inside) > STACKED else ()),
        Section(
            title="Delays",
            intro="What the emulated network drew lies broad beneath what the receiver measured from time stamps; "
            "where they part, a packet was late, lost or not yet there.",
            blocks=(*delay_panels(run, marks), network_table(summary["network"], laws)),
        ),
        Section(title="Network against its law", columns=2, blocks=tuple(network_blocks(run, summary["network"], laws))),
        Section(title="Timing", blocks=() if lateness is None else (lateness,)),
        Section(title="Distribution of times", columns=2, blocks=tuple(timing_blocks(run, summary["timing"]))),
        Section(title="Summary", columns=sum(not table.wide for table in tables), blocks=tuple(tables)),
        Section(title="Events", blocks=tuple(_events(run))),
    ]
    return [section for section in found if section.blocks]


def verdicts(run: Run, summary: Mapping[str, Any]) -> list[Badge]:
    """Return the verdicts on a run: its timing, its safety, its certificate, its log."""
    timing, found = summary["timing"], []
    if summary["clock"] == "virtual":
        found.append(Badge(label="virtual time", state="good", detail="times are exact"))
    elif timing["valid"]:
        p99 = timing["lateness_us"]["p99"]
        found.append(Badge(label="timing valid", state="good", detail=f"lateness p99 {text_of(p99, 3)} µs"))
    else:
        found.append(Badge(label="timing not valid", state="bad", detail="; ".join(timing["why"])))
    if summary.get("safety"):
        found.append(Badge(label="stopped by safety", state="bad", detail=str(summary["safety"])))
    else:
        found.append(Badge(label="safety not tripped", state="good"))
    certificate = summary.get("certificate")
    if certificate is None:
        found.append(Badge(label="no certificate", state="warning", detail="none exists for this kind of loop"))
    else:
        radius = certificate.get("mean_square_radius")
        detail = "" if radius is None else f"second-moment radius {text_of(float(radius))}"
        stable = bool(certificate.get("stable"))
        label = "certified mean-square stable" if stable else "not mean-square stable"
        found.append(Badge(label=label, state="good" if stable else "bad", detail=detail))
    dropped = summary.get("log", {}).get("dropped", 0)
    if dropped:
        found.append(Badge(label="log incomplete", state="warning", detail=f"{text_of(dropped)} records dropped"))
    found += [
        Badge(label=str(name).replace("_", " "), state="bad", detail=str(value))
        for name, value in summary.get("problems", {}).items()
    ]
    return found


def _tiles(run: Run, metrics: Mapping[str, Any]) -> list[Tile]:
    units = _metric_units(run)
    overshoot = metrics["overshoot"]
    settling = metrics["settling_time_s"]
    stepped = bool(reference_steps(run))
    of_step = "of the step" if stepped else "no step"
    error = _rounded(metrics["steady_state_error"])
    return [
        Tile(label="Squared error", value=metrics["sse"], unit=units["sse"], note="whole run, × T"),
        Tile(label="Squared error after 5 s", value=metrics["sse_after_5s"], unit=units["sse"]),
        Tile(label="Overshoot", value=None if overshoot is None else 100.0 * overshoot, unit="%", note=of_step),
        Tile(
            label="Settling time",
            value=settling,
            unit="s",
            note="no step" if not stepped else "not settled to 2 %" if settling is None else "to 2 %",
            state="warning" if stepped and settling is None else "neutral",
        ),
        Tile(label="Steady-state error", value=error, unit=units["steady_state_error"], note="last tenth"),
        Tile(label="Largest input", value=metrics["max_abs_u"], unit=units["max_abs_u"]),
    ]


def _metric_units(run: Run, mixed: str | None = None) -> dict[str, str]:
    outputs = [unit_of(run, "/plant/measurement", name) for name in tracked_names(run, experiment_of(run))]
    inputs = [unit_of(run, "/actuator/applied", name) for name in signal_names(run, "/actuator/applied")]
    return metric_units(outputs, inputs, mixed)


def _words(name: str) -> str:
    return name.replace("_", " ")


def _rounded(value: float | None) -> float | str | None:
    # Below a millionth the digits say nothing; "1e-8" set large would look like a finding.
    return value if value is None or abs(value) >= 1e-6 else "≈ 0"


def _facts(run: Run, summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    resolved = run.resolved
    period_s = period_of(run)
    found = [
        ("Plant", str(resolved.get("plant", {}).get("kind", ""))),
        ("Controller", str(resolved.get("controller", {}).get("kind", ""))),
        ("Clock", str(summary["clock"])),
        ("Link", str(summary["link"])),
        ("Sample period", f"{text_of(1e3 * period_s)} ms"),
        ("Duration", f"{text_of(float(summary['duration_s']))} s, {text_of(int(summary['ticks']))} ticks"),
        ("Seed", str(summary["seed"])),
    ]
    if run.session.get("started"):
        found.append(("Started", run.session["started"]))
    return [(name, value) for name, value in found if value]


def _summary_tables(run: Run, summary: Mapping[str, Any]) -> list[Table]:
    metrics = summary["metrics"]
    names = {
        "sse": "squared error, summed, × T",
        "sse_after_5s": "… from 5 s on",
        "overshoot": "overshoot",
        "settling_time_s": "settling time to 2 %",
        "steady_state_error": "steady-state error, last tenth",
        "max_abs_u": "largest input",
    }
    outputs: Mapping[str, Mapping[str, Any]] = metrics.get("outputs", {})
    columns = [with_unit(_words(name), unit_of(run, "/plant/measurement", name)) for name in outputs]
    units = _metric_units(run, mixed="unit")
    several = units["steady_state_error"] == "unit"
    rows: list[list[Cell]] = [
        [with_unit(text, units[key]), metrics[key], *(o.get(key) for o in outputs.values())] for key, text in names.items()
    ]
    tables = [
        Table(
            title="Tracking",
            columns=["metric", "all outputs" if outputs else "value", *columns],
            rows=rows,
            wide=bool(outputs),
            note="Before the first step the error counts against the value stepped to, as in Table 7.2. Overshoot and "
            "settling time are judged up to the first disturbance." + (" The unit is that of the column." if several else ""),
        )
    ]
    certificate = summary.get("certificate")
    if certificate:
        tables.append(
            Table(
                title="Certificate, from the gains that ran",
                columns=["quantity", "value"],
                rows=[[str(k).replace("_", " "), _cell(v)] for k, v in certificate.items() if v is not None],
            )
        )
    log = summary.get("log")
    if log:
        tables.append(Table(title="Log", columns=["what", "value"], rows=[[k, _cell(v)] for k, v in log.items()]))
    return tables


def _events(run: Run) -> list[Block]:
    rows: list[list[Cell]] = []
    for event in sorted(run.events, key=_when)[:MOST_EVENTS]:
        severity = str(event.get("severity", "info"))
        state = {"warning": "warning", "error": "bad"}.get(severity, "neutral")
        badge = Badge(label=severity, state=state)  # type: ignore[arg-type]
        rows.append([_when(event), badge, str(event.get("kind", "")), str(event.get("message", ""))])
    if not rows:
        return []
    more = len(run.events) - len(rows)
    note = f"{more} more are in the log." if more > 0 else ""
    return [Table(columns=["t (s)", "severity", "kind", "message"], rows=rows, note=note)]


def _when(event: Mapping[str, Any]) -> float:
    return float(event.get("t_s", 0.0))


def _about(run: Run) -> list[Section]:
    resolved = json.dumps(plain(run.resolved), indent=2, ensure_ascii=False)
    versions: list[list[Cell]] = [[name, version] for name, version in run.versions.items()]
    origin: list[list[Cell]] = [[k.replace("_", " "), v] for k, v in {**run.metadata, **run.session}.items()]
    return [
        Section(
            title="Experiment",
            blocks=(
                Text(text=run.experiment_text or "(no text in the log)", code=True, title="As written"),
                Text(text=resolved, code=True, folded=True, title="Resolved, with every default"),
            ),
        ),
        Section(
            title="Provenance",
            columns=2,
            blocks=(
                Table(title="Session", columns=["what", "value"], rows=origin),
                Table(title="Versions", columns=["package", "version"], rows=versions),
            ),
        ),
    ]


def _cell(value: Any) -> Cell:
    return value if value is None or isinstance(value, str | int | float | bool) else json.dumps(plain(value))
