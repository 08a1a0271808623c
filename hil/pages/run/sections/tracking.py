"""The run over time: outputs against their reference, states, inputs, and the topics that no other section draws."""

from __future__ import annotations

from hil.measure.view import RunView
from hil.pages.html.figures import Figure, Section
from hil.pages.run.time_panels import follows_reference, input_panels, markers, output_panels, state_panels, topic_panels

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


SECTIONS = (tracking, states)
