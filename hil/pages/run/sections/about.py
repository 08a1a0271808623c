"""What ran and where it comes from: the experiment as written and resolved, the session, the versions."""

from __future__ import annotations

import json

from hil.log.events import plain
from hil.measure.view import RunView
from hil.pages.html.figures import Cell, Section, Table, Text


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
    """Return session and versions."""
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


SECTIONS = (experiment, provenance)
