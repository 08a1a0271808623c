"""The registry of a run page's sections: every module of this folder gives its `SECTIONS`. A new section is one file here.

A section comes from a function of the run, ours, or from a plug-in of the experiment with the method `section(view)`: a measure,
the plant, the controller or a network law (`DrawsSection`). `Section.place` says where it stands.

What a plug-in gives is taken as plain data: every field is of the type that `figures` states, copied, and bounded in size. The
renderer escapes text, and writes numbers and words of a list (`colour`, `state`, `height_px`) as they are. So a field that is
not of its type, or a text with methods of its own, would stand in the page as markup: such a section is refused.
"""

from __future__ import annotations

import types
from collections.abc import Callable, Sequence
from collections.abc import Set as AbstractSet
from functools import cache
from importlib import import_module
from numbers import Integral, Real
from pkgutil import iter_modules
from typing import Any, Final, Literal, Protocol, TypeAlias, Union, get_args, get_origin, get_type_hints, runtime_checkable

import numpy as np
from msgspec import Struct
from msgspec.structs import asdict

from hil.measure import run_measures
from hil.measure.view import RunView
from hil.pages import Badge, Figure, Section
from hil.pages.html.page import block_html
from hil.pages.html.payload import Payload
from hil.plugins.user_plugins import asked, words

Draw: TypeAlias = Callable[[RunView], Section | None]

MOST_WORDS = 2000
"""Characters of an error's message on a page."""

MOST_VALUES = 2_000_000
"""Numbers and characters of a section."""

MOST_BYTES = 4_000_000
"""Of a section in the page; long curves are reduced before."""

HEIGHTS = (50, 1000)


@runtime_checkable
class DrawsSection(Protocol):
    """A plug-in that draws: its section stands in the page of every run of an experiment that names it."""

    def section(self, view: RunView) -> Section | None:
        """Return what it shows of a run, a `hil.pages.Section`; None where it has nothing to show."""


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
    """Return the section of a plug-in as plain data; a section that says what went wrong where it draws none.

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


def plain_section(given: object) -> Section:
    """Return a section whose fields are what they are said to be.

    Raises:
        TypeError: a field is of another type, with its path.
        ValueError: it is too large, or cannot be drawn.
    """
    section: Section = _Copy().of(given, Section, "section")
    for i, block in enumerate(section.blocks):
        if isinstance(block, Figure) and not HEIGHTS[0] <= block.height_px <= HEIGHTS[1]:
            raise ValueError(f"section.blocks[{i}].height_px: {block.height_px}, expected {HEIGHTS[0]} to {HEIGHTS[1]}")
    payload = Payload()
    size = sum(len(block_html(block, payload)) for block in section.blocks) + len(payload.json())
    if size > MOST_BYTES:
        raise ValueError(f"section: {size / 1e6:.1f} MB in the page, at most {MOST_BYTES / 1e6:g}: reduce its tables and bars")
    return section


class _Copy:
    """Copies values after their types and counts them."""

    def __init__(self) -> None:
        self._values = 0

    def of(self, value: Any, hint: Any, path: str) -> Any:
        origin, options = get_origin(hint), get_args(hint)
        if origin in (Union, types.UnionType):
            return self._one_of(value, options, path)
        if origin is Literal:
            text = self.of(value, str, path)
            return text if text in options else self._refuse(value, hint, path)
        if origin is tuple and Ellipsis not in options:
            if not isinstance(value, tuple | list) or len(value) != len(options):
                return self._refuse(value, hint, path)
            return tuple(self.of(item, each, f"{path}[{i}]") for i, (item, each) in enumerate(zip(value, options)))
        if origin in (tuple, Sequence, frozenset):
            wanted = AbstractSet if origin is frozenset else Sequence | np.ndarray
            if isinstance(value, str) or not isinstance(value, wanted):
                return self._refuse(value, hint, path)
            self._count(len(value), path)
            items = [self.of(item, options[0], f"{path}[{i}]") for i, item in enumerate(value)]
            return frozenset(items) if origin is frozenset else tuple(items)
        if hint is Any:  # numbers, see `hil.pages.FloatArray`
            self._count(np.size(value) if isinstance(value, np.ndarray) else len(value), path)
            return np.array(value, dtype=np.float64)
        if isinstance(hint, type) and issubclass(hint, Struct) and isinstance(value, hint):
            return hint(**{name: self.of(part, _hints(hint)[name], f"{path}.{name}") for name, part in asdict(value).items()})
        if hint is str and isinstance(value, str):
            self._count(len(value), path)
            return str.__str__(value)  # of a text with methods of its own, the text alone
        if hint is bool and isinstance(value, bool | np.bool_):
            return bool(value)
        if isinstance(value, bool | np.bool_):
            return self._refuse(value, hint, path)
        if hint is int and isinstance(value, Integral):
            return int(value)
        if hint is float and isinstance(value, Real):
            return float(value)
        return self._refuse(value, hint, path)

    def _one_of(self, value: Any, options: tuple[Any, ...], path: str) -> Any:
        if value is None and types.NoneType in options:
            return None
        for option in options:
            if isinstance(option, type) and issubclass(option, Struct) and isinstance(value, option):
                return self.of(value, option, path)
        for option in options:
            try:
                return self.of(value, option, path)
            except TypeError:
                continue
        return self._refuse(value, " or ".join(getattr(option, "__name__", str(option)) for option in options), path)

    def _count(self, more: int, path: str) -> None:
        self._values += more
        if self._values > MOST_VALUES:
            raise ValueError(f"{path}: more than {MOST_VALUES} numbers and characters in one section")

    def _refuse(self, value: Any, hint: Any, path: str) -> Any:
        wanted = getattr(hint, "__name__", str(hint))
        raise TypeError(f"{path}: {type(value).__name__} {value!r:.60}, expected {wanted:.200}")


@cache
def _hints(made: type) -> dict[str, Any]:
    return get_type_hints(made)


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
