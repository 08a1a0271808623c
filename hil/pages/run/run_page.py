"""The report of one run: what `hil report` writes."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from hil.log.events import plain
from hil.log.run import Run
from hil.measure.measure import Quantity, measures_of, quantities_of
from hil.measure.network_paths import network_paths
from hil.measure.signals import with_unit
from hil.measure.view import RunView
from hil.pages.html.figures import Badge, Block, Cell, Lines, Section, State, Table, Text, Tile
from hil.pages.html.numbers import text_of
from hil.pages.html.page import render_page
from hil.pages.run.sensor_blocks import sensor_blocks
from hil.pages.run.statistics import network_blocks, network_table, timing_blocks
from hil.pages.run.time_panels import (
    Prediction,
    delay_panels,
    input_panels,
    lateness_panel,
    markers,
    output_panels,
    state_panels,
    topic_panels,
)

MOST_EVENTS = 300
STACKED = 2
"""Up to so many states and inputs stand below the outputs; more stand side by side."""


def render_report(
    view: RunView,
    summary: Mapping[str, Any],
    *,
    predicted: Mapping[str, Prediction] | None = None,
    sections: Sequence[Section] = (),
) -> str:
    """Return the report of a run as one self-contained HTML page.

    Args:
        view: the run.
        summary: what `hil.measure.summary.summarise` says of it (with or without the parts `log` and `problems`).
        predicted: curves and bands of a theory, by output, drawn behind the run.
        sections: further sections, set before the experiment.
    """
    run = view.run
    parts = [*run_sections(view, summary, predicted or {}), *sections, *_about(run)]
    description = str(run.resolved.get("description", ""))
    return render_page(
        str(summary["experiment"] or "Run"),
        parts,
        kicker="hilrig · run report",
        subtitle=description,
        badges=verdicts(run, summary),
        tiles=_tiles(view, summary["metrics"]),
        facts=_facts(view, summary),
        footer=f"Written by hilrig {run.versions.get('hilrig', '')} from the log alone. Drag across a plot to zoom all "
        "time axes, double-click to reset.",
    )


def run_sections(view: RunView, summary: Mapping[str, Any], predicted: Mapping[str, Prediction]) -> list[Section]:
    """Return the sections that show what happened, in reading order; empty ones are left out."""
    run, marks, paths = view.run, markers(view), network_paths(view)
    lateness = lateness_panel(view, marks)
    tables = _summary_tables(view, summary)
    outputs = output_panels(view, marks, predicted)
    inside: tuple[Block, ...] = (*state_panels(view, marks), *input_panels(view, marks), *topic_panels(view, marks))
    found = [
        Section(title="Tracking", blocks=(*outputs, *(inside if len(inside) <= STACKED else ()))),
        Section(title="States and inputs", columns=2, blocks=inside if len(inside) > STACKED else ()),
        Section(
            title="Delays",
            intro="The broad line is the delay that the emulated network drew, the thin line what the receiver measured "
            "from time stamps. They differ where a packet was late, lost or still on its way.",
            blocks=(*delay_panels(view, marks), network_table(summary["network"], paths)),
        ),
        Section(title="Sensor nodes", blocks=tuple(sensor_blocks(view, marks))),
        Section(title="Network against its law", columns=2, blocks=tuple(network_blocks(run, summary["network"], paths))),
        Section(title="Timing", blocks=() if lateness is None else (lateness,)),
        Section(title="Distribution of times", columns=2, blocks=tuple(timing_blocks(run, summary["timing"]))),
        Section(title="Summary", columns=sum(not table.wide for table in tables), blocks=tuple(tables)),
        Section(title="Events", blocks=tuple(_events(run))),
    ]
    return [section for section in found if section.blocks]


_UNITS: Mapping[str, str] = {"_n_s_per_m": "N s/m", "_n_per_m": "N/m", "_m_per_n": "m/N"}
_COLOURS: Mapping[str, State] = {"certified": "good", "refused": "bad"}


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
    if summary.get("controller") == "external":
        found.append(Badge(label="external controller", state="warning", detail="another program answered, not the experiment's"))
    if certificate is None:
        found.append(Badge(label="no certificate", state="warning", detail="the run asked for none"))
    else:
        state = str(certificate.get("state", "no verdict"))
        label, detail = f"{state}: {certificate.get('kind', 'certificate')}", str(certificate.get("reason", ""))
        found.append(Badge(label=label, state=_COLOURS.get(state, "warning"), detail=detail))
    dropped = summary.get("log", {}).get("dropped", 0)
    if dropped:
        found.append(Badge(label="log incomplete", state="warning", detail=f"{text_of(dropped)} records dropped"))
    found += [
        Badge(label=str(name).replace("_", " "), state="bad", detail=str(value))
        for name, value in summary.get("problems", {}).items()
    ]
    return found


def _tiles(view: RunView, metrics: Mapping[str, Any]) -> list[Tile]:
    return [_tile(view, quantity, metrics[quantity.name]) for quantity in _quantities(view)]


def _tile(view: RunView, quantity: Quantity, value: float | None) -> Tile:
    label = quantity.title[:1].upper() + quantity.title[1:]
    if value is None and quantity.needs and not any(mark.label == quantity.needs for mark in view.marks):
        return Tile(label=label, value=None, unit=quantity.unit, note=f"no {quantity.needs.rpartition(' ')[2]}")
    if value is None and quantity.absent:
        return Tile(label=label, value=None, unit=quantity.unit, note=quantity.absent, state="warning")
    if quantity.share_of:
        share = None if value is None else 100.0 * value
        return Tile(label=label, value=share, unit="%", note=f"of {quantity.share_of}")
    return Tile(label=label, value=_rounded(value), unit=quantity.unit, note=quantity.note)


def _quantities(view: RunView) -> tuple[Quantity, ...]:
    return quantities_of(measures_of(view.experiment), view.signals)


def _words(name: str) -> str:
    return name.replace("_", " ")


def _quantity(name: str) -> str:
    """Return the name of a number as a person reads it, its unit behind it.

    >>> _quantity("ceiling_n_per_m"), _quantity("worst_delay")
    ('ceiling (N/m)', 'worst delay')
    """
    for ending, unit in _UNITS.items():
        if name.endswith(ending):
            return with_unit(_words(name.removesuffix(ending)), unit)
    return _words(name)


def _rounded(value: float | None) -> float | str | None:
    # Below a millionth the digits say nothing; "1e-8" set large would look like a finding.
    return value if value is None or value == 0.0 or abs(value) >= 1e-6 else "≈ 0"


def _facts(view: RunView, summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    run, resolved = view.run, view.run.resolved
    found = [
        ("Plant", str(resolved.get("plant", {}).get("kind", ""))),
        ("Controller", str(resolved.get("controller", {}).get("kind", ""))),
        ("Clock", str(summary["clock"])),
        ("Link", str(summary["link"])),
        ("Sample period", f"{text_of(1e3 * view.period_s)} ms"),
        ("Duration", f"{text_of(float(summary['duration_s']))} s, {text_of(int(summary['ticks']))} slots"),
        ("Seed", str(summary["seed"])),
    ]
    if run.session.get("started"):
        found.append(("Started", run.session["started"]))
    return [(name, value) for name, value in found if value]


def _summary_tables(view: RunView, summary: Mapping[str, Any]) -> list[Table]:
    metrics, signals = summary["metrics"], view.signals
    outputs: Mapping[str, Mapping[str, Any]] = metrics.get("outputs", {})
    columns = [with_unit(_words(name), signals.outputs[name]) for name in outputs]
    several = bool(outputs) and signals.tracked_unit() is None
    measures = measures_of(view.experiment)
    tables = []
    for measure in measures:
        quantities = measure.quantities(signals.in_unit("unit") if several else signals)
        rows: list[list[Cell]] = [
            [_row_label(q), metrics[q.name], *(o.get(q.name) for o in outputs.values())] for q in quantities
        ]
        tables.append(
            Table(
                title=measure.title,
                columns=["metric", "all outputs" if outputs else "value", *columns],
                rows=rows,
                wide=bool(outputs),
                note=measure.note + (" The unit is that of the column." if several else ""),
            )
        )
    log = summary.get("log")
    if log:
        tables.append(Table(title="Log", columns=["what", "value"], rows=[[k, _cell(v)] for k, v in log.items()]))
    certificate = summary.get("certificate")
    if certificate:
        tables.append(
            Table(
                title="Certificate" if summary.get("controller") == "external" else "Certificate, from the gains that ran",
                columns=["quantity", "value"],
                rows=[[_quantity(str(k)), _cell(v)] for k, v in certificate.items() if v is not None],
                wide=True,
            )
        )
    return tables


def _row_label(quantity: Quantity) -> str:
    label = f"{quantity.title}, {quantity.note}" if quantity.note else quantity.title
    return with_unit(label, f"share of {quantity.share_of}" if quantity.share_of else quantity.unit)


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
    """Return a value of a summary as a person reads it: sentences one below the other, numbers in one line."""
    if value is None or isinstance(value, str | int | float | bool):
        return value
    if isinstance(value, Mapping):
        return Lines(tuple(f"{_words(str(name))}: {_in_line(v)}" for name, v in value.items()))
    items = list(value)
    if any(isinstance(item, str) and " " in item for item in items):
        return Lines(tuple(map(_in_line, items)))
    return _in_line(items) or "none"


def _in_line(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{_words(str(name))} {_in_line(v)}" for name, v in value.items())
    if isinstance(value, Sequence) and not isinstance(value, str):
        within = [f"({_in_line(v)})" if isinstance(v, Sequence) and not isinstance(v, str) else _in_line(v) for v in value]
        return ", ".join(within)
    return text_of(value)
