"""Measured times: lateness and round trip over time, and their distributions; nothing for a run in virtual time."""

from __future__ import annotations

from hil.measure.view import RunView
from hil.pages.html.figures import Section
from hil.pages.run.page_summary import page_summary
from hil.pages.run.statistics import timing_blocks
from hil.pages.run.time_panels import lateness_panel, markers


def lateness(view: RunView) -> Section | None:
    """Return lateness and round trip over time."""
    panel = lateness_panel(view, view.once(markers))
    return None if panel is None else Section(title="Timing", place=60, blocks=(panel,))


def distribution(view: RunView) -> Section | None:
    """Return the distributions of lateness and round trip."""
    blocks = tuple(timing_blocks(view.run, view.once(page_summary)["timing"]))
    return Section(title="Distribution of times", place=70, columns=2, blocks=blocks) if blocks else None


SECTIONS = (lateness, distribution)
