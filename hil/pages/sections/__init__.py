"""The registry of a run page's sections: every module of this folder gives its `SECTIONS`. A new section is one file here.

A section comes from a function of the run, ours, or from a plug-in of the experiment with the method `section(view)`: a measure,
the plant, the controller or a network law (`DrawsSection`). `Section.place` says where it stands.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pkgutil import iter_modules
from typing import Final, Protocol, TypeAlias, runtime_checkable

from hil.measure.measure import run_measures
from hil.measure.view import RunView
from hil.pages.html.figures import Badge, Section
from hil.pages.html.plain_section import plain_section
from hil.plugins.user_plugins import asked, words

Draw: TypeAlias = Callable[[RunView], Section | None]

MOST_WORDS = 2000
"""Characters of an error's message on a page."""


@runtime_checkable
class DrawsSection(Protocol):
    """A plug-in that draws: its section stands in the page of every run of an experiment that names it."""

    def section(self, view: RunView) -> Section | None:
        """Return what it shows of a run, a `hil.pages.Section`; None where it has nothing to show."""
        ...


def drawing_plug_ins(view: RunView) -> tuple[DrawsSection, ...]:
    """Return the plug-ins of a run's experiment that draw, each once: measures, plant, controller, network laws."""
    e = view.experiment
    parts: tuple[object, ...] = view.once(run_measures)
    if e is not None:
        parts += (e.plant, e.controller, *(() if view.rig is None else view.rig.laws))
    found = {id(part): part for part in parts if isinstance(part, DrawsSection)}
    return tuple(found.values())


def check_section(plug_in: object, view: RunView) -> list[str]:
    """Check what a plug-in draws: a section of plain data, bounded in size, also of a run without records.

    Args:
        plug_in: a measure, plant, controller or network law.
        view: a run that it shall draw.

    Returns:
        What it has earned, a sentence.

    Raises:
        AssertionError: what it does not keep, in the words of its author.
    """
    name = type(plug_in).__name__
    if not isinstance(plug_in, DrawsSection):
        return [f"{name} is no DrawsSection (no section(view)): it draws no figure"]
    for what, one in (("a run without records", view.without_records()), ("a run", view)):
        found = asked(f"{what}: section(view)", plug_in.section, one)
        shown = "nothing" if found is None else repr(asked(what, plain_section, found).title)
    return [f"{name} is a DrawsSection: the page of a run has its section, here {shown}"]


def drawn(plug_in: DrawsSection, view: RunView) -> Section | None:
    """Return the section of a plug-in as plain data; a section that says what went wrong where that cannot be had.

    Args:
        plug_in: a class of the user's own; whatever it raises or returns, the page is made.
        view: the run.
    """
    try:
        found = plug_in.section(view)
        return None if found is None else plain_section(found)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # whatever a user's code raises, SystemExit too
        name = type(plug_in).__name__
        failed = Badge(label=f"{name} draws no section", state="bad", detail=words(error)[:MOST_WORDS])
        return Section(title=name, blocks=(failed,))


def _registered() -> tuple[Draw, ...]:
    modules = [import_module(module.name) for module in iter_modules(__path__, f"{__name__}.")]
    return tuple(draw for module in modules for draw in module.SECTIONS)


SECTIONS: Final = _registered()
"""Ours, each a function of the run that returns its section, or None where it has nothing to show."""


def sections_of(view: RunView) -> list[Section]:
    """Return the sections of a run's page in the order of their places: ours and those of the experiment's plug-ins."""
    ours = [draw(view) for draw in SECTIONS]
    theirs = [drawn(plug_in, view) for plug_in in drawing_plug_ins(view)]
    return sorted((section for section in (*ours, *theirs) if section is not None), key=lambda section: section.place)
