"""Plug-ins by entry point: plants, controllers and network laws, ours through the same door as a user's."""

from __future__ import annotations

import difflib
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Literal

from hil.errors import HilError

Group = Literal["hil.plants", "hil.controllers", "hil.laws", "hil.links", "hil.measures"]


@cache
def _found(group: str) -> dict[str, EntryPoint]:
    return {e.name: e for e in entry_points(group=group)}


def names(group: Group) -> list[str]:
    """Return the names of every plug-in of a group, sorted.

    >>> "dc-motor" in names("hil.plants")
    True
    """
    return sorted(_found(group))


def load(group: Group, name: str) -> type:
    """Return the parameter class of one plug-in.

    Raises:
        HilError: if no such plug-in is installed (the message names the nearest), or its module cannot be imported.
    """
    found = _found(group)
    if name not in found:
        near = difflib.get_close_matches(name, found, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise HilError(f"no {group[4:-1]} plug-in is called {name!r}{hint} (there are: {', '.join(sorted(found))})")
    try:
        plugin: type = found[name].load()
    except (ImportError, AttributeError) as e:
        raise HilError(f"{group[4:-1]} plug-in {name!r} cannot be loaded from {found[name].value}: {e}") from e
    return plugin


def provider(group: Group, name: str) -> str:
    """Return the distribution that a plug-in comes from, for `hil doctor` and for provenance."""
    dist = _found(group)[name].dist
    return dist.name if dist is not None else "?"
