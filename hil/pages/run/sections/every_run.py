"""Sections of every run: the run over time, its delays and network laws, its measured times, and what ran."""

from __future__ import annotations

import json

from hil.log.events import plain
from hil.measure.network_paths import network_paths
from hil.measure.summary import page_summary
from hil.measure.view import RunView
from hil.pages.html.figures import Cell, Figure, Section, Table, Text
from hil.pages.run.statistics import network_blocks, network_table, timing_blocks
from hil.pages.run.time_panels import (
    delay_panels,
    follows_reference,
    input_panels,
    lateness_panel,
    markers,
    output_panels,
    state_panels,
    topic_panels,
)

STACKED = 2
"""Up to so many states and inputs stand below the outputs; more stand side by side in a section of their own."""


def tracking(view: RunView) -> Section | None:
    """Return outputs against their reference, with the few states and inputs that stand below them."""
    inside = view.once(_inside)
    blocks = (*output_panels(view, view.once(markers)), *(inside if len(inside) <= STACKED else ()))
    title = "Tracking" if follows_reference(view) else "Outputs"
    return Section(title=title, place=10, blocks=blocks) if blocks else None


def states(view: RunView) -> Section | None:
    """Return states and inputs where they are many."""
    inside = view.once(_inside)
    return Section(title="States and inputs", place=20, columns=2, blocks=inside) if len(inside) > STACKED else None


def _inside(view: RunView) -> tuple[Figure, ...]:
    marks = view.once(markers)
    return (*state_panels(view, marks), *input_panels(view, marks), *topic_panels(view, marks))


def delays(view: RunView) -> Section:
    """Return the delays of both directions over time, and a row for each emulated network."""
    found = network_table(view.once(page_summary)["network"], view.once(network_paths))
    return Section(
        title="Delays",
        place=30,
        intro="The broad line is the delay that the emulated network drew, the thin line what the receiver measured "
        "from time stamps. They differ where a packet was late, lost or still on its way.",
        blocks=(*delay_panels(view, view.once(markers)), found),
    )


def statistics(view: RunView) -> Section | None:
    """Return frequencies, transitions and sojourns of the emulated network beside what its laws state."""
    blocks = tuple(network_blocks(view.run, view.once(page_summary)["network"], view.once(network_paths)))
    return Section(title="Network against its law", place=50, columns=2, blocks=blocks) if blocks else None


def lateness(view: RunView) -> Section | None:
    """Return lateness and round trip over time; nothing for a run in virtual time."""
    panel = lateness_panel(view, view.once(markers))
    return None if panel is None else Section(title="Timing", place=60, blocks=(panel,))


def distribution(view: RunView) -> Section | None:
    """Return the distributions of lateness and round trip."""
    blocks = tuple(timing_blocks(view.run, view.once(page_summary)["timing"]))
    return Section(title="Distribution of times", place=70, columns=2, blocks=blocks) if blocks else None


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


SECTIONS = (tracking, states, delays, statistics, lateness, distribution, experiment, provenance)
