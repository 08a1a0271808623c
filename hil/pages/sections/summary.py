"""The numbers of the measures, the certificate and the events of a run, as tables; what ran, and where it comes from."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from hil.log import plain
from hil.log.run import Run
from hil.measure import Quantity, run_measures
from hil.measure.signals import with_unit
from hil.measure.summary import page_summary
from hil.measure.view import RunView
from hil.pages import Badge, Cell, Lines, Section, Table, Text
from hil.pages.html import text_of

MOST_EVENTS = 300
_UNITS: Mapping[str, str] = {"_n_s_per_m": "N s/m", "_n_per_m": "N/m", "_m_per_n": "m/N"}
_CERTIFICATE: Mapping[str, str] = {
    "mean_square_radius": "second-moment radius (stable below 1)",
    "tail_radius": "second-moment radius with the tail that is cut (stable below 1)",
    "long_stay_radius": "growth per slot in stays that last long (unstable above 1)",
    "lyapunov_margin": "margin of the inequality (7.17) that proves stability (above 0)",
    "positivity_margin": "smallest eigenvalue of the matrices that fulfil it (above 0)",
    "rounding": "bound of the rounding error of both",
    "h2_norm": "H2 norm (7.20), of a unit impulse",
    "h2_residual": "relative residual of its equation (7.21)",
    "hinf_norm": "H-infinity norm (7.27)",
    "hinf_margin": "margin of the inequality (7.28) that proves it (above 0)",
    "modes": "modes of the jump-linear system",
    "order": "states of the jump-linear system",
    "selection": "row rule",
    "initial": "mode at the impulse of the H2 norm",
    "output": "weighted outputs: stacked, or their sum",
    "digest": "SHA-256 of the loop that is judged",
}
"""Keys of `summary["certificate"]` in words."""


def numbers(view: RunView) -> Section | None:
    """Return the tables of all measures, of the log and of the certificate."""
    tables = _summary_tables(view, view.once(page_summary))
    across = sum(not table.wide for table in tables)
    return Section(title="Summary", place=80, columns=across, blocks=tuple(tables)) if tables else None


def events(view: RunView) -> Section | None:
    """Return what happened, in the order of time."""
    rows = _rows(view.run)
    more = len(view.run.events) - len(rows)
    table = Table(
        columns=["t (s)", "severity", "kind", "message"], rows=rows, note=f"{more} more are in the log." if more > 0 else ""
    )
    return Section(title="Events", place=90, blocks=(table,)) if rows else None


def experiment(view: RunView) -> Section:
    """Return the experiment as written and resolved."""
    resolved = json.dumps(plain(view.run.resolved), indent=2, ensure_ascii=False)
    return Section(
        title="Experiment",
        place=900,
        blocks=(
            Text(text=view.run.experiment_text or "(no text in the log)", code=True, title="As written"),
            Text(text=resolved, code=True, folded=True, title="Resolved, with every default"),
        ),
    )


def provenance(view: RunView) -> Section:
    """Return session and versions: what ran, and where it comes from."""
    run = view.run
    versions: list[list[Cell]] = [[name, version] for name, version in run.versions.items()]
    origin: list[list[Cell]] = [[k.replace("_", " "), v] for k, v in {**run.metadata, **run.session}.items()]
    return Section(
        title="Provenance",
        place=910,
        columns=2,
        blocks=(
            Table(title="Session", columns=["what", "value"], rows=origin),
            Table(title="Versions", columns=["package", "version"], rows=versions),
        ),
    )


SECTIONS = (numbers, events, experiment, provenance)


def _summary_tables(view: RunView, summary: Mapping[str, Any]) -> list[Table]:
    metrics, signals = summary["metrics"], view.signals
    outputs: Mapping[str, Mapping[str, Any]] = metrics.get("outputs", {})
    columns = [with_unit(_words(name), signals.outputs[name]) for name in outputs]
    several = bool(outputs) and signals.tracked_unit() is None
    measures = view.once(run_measures)
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
        title = "Certificate" if summary.get("controller") == "external" else "Certificate, from the gains that ran"
        tables += _certificate(title, certificate)
    return tables


def _certificate(title: str, certificate: Mapping[str, Any]) -> list[Table]:
    """Return what a certificate says, an answer to each question, and its further numbers behind a click."""
    said = {name: value for name, value in certificate.items() if value is not None}
    deciding = f"{said['quantity']}: {_in_line(said['number'])}" if {"quantity", "number"} <= said.keys() else ""
    limit = f"; the limit is {_in_line(said['limit'])}" if deciding and "limit" in said else ""
    answers: list[tuple[str, Cell]] = [
        ("Verdict", ": ".join(str(said[name]) for name in ("state", "reason") if name in said)),
        ("What is certified" if said.get("state") == "certified" else "What was asked", str(said.get("kind", ""))),
        ("The number that decides", deciding + limit),
        ("How it is decided", str(said.get("method", ""))),
        ("What it assumes", _cell(said.get("assumptions", ""))),
    ]
    shown = {"state", "reason", "kind", "quantity", "number", "limit", "method", "assumptions"}
    others = [[_CERTIFICATE.get(str(k)) or _quantity(str(k)), _cell(v)] for k, v in said.items() if k not in shown]
    found = [Table(title=title, columns=["question", "answer"], rows=[list(row) for row in answers if row[1]], wide=True)]
    if others:
        found.append(
            Table(title="Further numbers of the certificate", columns=["quantity", "value"], rows=others, wide=True, folded=True)
        )
    return found


def _row_label(quantity: Quantity) -> str:
    label = f"{quantity.title}, {quantity.note}" if quantity.note else quantity.title
    return with_unit(label, quantity.unit)


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


def _rows(run: Run) -> list[list[Cell]]:
    rows: list[list[Cell]] = []
    for event in sorted(run.events, key=_when)[:MOST_EVENTS]:
        severity = str(event.get("severity", "info"))
        state = {"warning": "warning", "error": "bad"}.get(severity, "neutral")
        badge = Badge(label=severity, state=state)  # type: ignore[arg-type]
        rows.append([_when(event), badge, str(event.get("kind", "")), str(event.get("message", ""))])
    return rows


def _when(event: Mapping[str, Any]) -> float:
    return float(event.get("t_s", 0.0))


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
