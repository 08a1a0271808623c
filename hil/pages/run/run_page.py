"""The report of one run: what `hil report` writes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hil.log.run import Run
from hil.measure.measure import Quantity, quantities_of, run_measures
from hil.measure.summary import page_summary
from hil.measure.view import RunView
from hil.pages.html.figures import Badge, State, Tile
from hil.pages.html.numbers import text_of
from hil.pages.html.page import Page
from hil.pages.run.sections import sections_of


def render_report(view: RunView) -> str:
    """Return the report of a run as one self-contained HTML page.

    Args:
        view: the run.
    """
    run = view.run
    summary = view.once(page_summary)
    description = str(run.resolved.get("description", ""))
    return Page(
        str(summary["experiment"] or "Run"),
        view.once(sections_of),
        kicker="hilrig · run report",
        subtitle=description,
        badges=verdicts(run, summary),
        tiles=_tiles(view, summary["metrics"]),
        facts=_facts(view, summary),
        footer=f"Written by hilrig {run.versions.get('hilrig', '')} from the log alone. Drag across a plot to zoom all "
        "time axes, double-click to reset.",
    ).html()


_COLOURS: Mapping[str, State] = {"certified": "good", "refused": "bad"}


def verdicts(run: Run, summary: Mapping[str, Any]) -> list[Badge]:
    """Return the verdicts on a run: its timing, its safety, its certificate, its log."""
    timing, found = summary["timing"], []
    if summary["clock"] == "virtual":
        found.append(Badge(label="virtual time", state="good", detail="times are exact"))
    elif timing["valid"]:
        name = "max" if timing["lateness_us"]["p99"] is None else "p99"
        worst = text_of(timing["lateness_us"][name], 3)
        found.append(Badge(label="timing valid", state="good", detail=f"lateness {name} {worst} µs"))
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
    return Tile(label=label, value=_rounded(value), unit=quantity.unit, note=quantity.note)


def _quantities(view: RunView) -> tuple[Quantity, ...]:
    return quantities_of(view.once(run_measures), view.signals)


def _rounded(value: float | None) -> float | str | None:
    # Below a millionth the digits say nothing; "1e-8" set large would look like a finding.
    return value if value is None or value == 0.0 or abs(value) >= 1e-6 else "≈ 0"


def _facts(view: RunView, summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    run, resolved = view.run, view.run.resolved
    found = [
        ("Plant", str(resolved.get("plant", {}).get("kind", ""))),
        ("Controller", str(resolved.get("controller", {}).get("kind", ""))),
        ("Clock", str(summary["clock"])),
        ("Link", str(summary["link"]) if summary["clock"] == "real" else ""),  # in virtual time no frame leaves the process
        ("Sample period", f"{text_of(1e3 * view.period_s)} ms"),
        ("Duration", f"{text_of(float(summary['duration_s']))} s, {text_of(int(summary['slots']))} slots"),
        ("Seed", str(summary["seed"])),
    ]
    if run.session.get("started"):
        found.append(("Started", run.session["started"]))
    return [(name, value) for name, value in found if value]
