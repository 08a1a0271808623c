"""The registry of a run page's sections: every module of this folder gives its `SECTIONS`. A new section is one file here.

A section comes from a function of the run, ours, or from a plug-in of the experiment with the method `section(view)`: a measure,
the plant, the controller or a network law (`DrawsSection`). `Section.place` says where it stands.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pkgutil import iter_modules
from typing import Final, TypeAlias

from hil.measure.view import RunView
from hil.pages.html.figures import Section
from hil.pages.run.drawn import drawing_plug_ins, drawn

Draw: TypeAlias = Callable[[RunView], Section | None]


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
