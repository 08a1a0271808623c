"""The numbers that the page of a run shows, computed once: `view.once(page_summary)`."""

from __future__ import annotations

from typing import Any

from hil.measure.summary import summarise
from hil.measure.view import RunView


def page_summary(view: RunView) -> dict[str, Any]:
    """Return the summary of a run, with what its log says of itself and of problems."""
    said: dict[str, Any] = {name: view.run.summary[name] for name in ("problems", "log") if name in view.run.summary}
    return {**summarise(view), **said}
