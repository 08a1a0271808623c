"""Plug-ins by entry point: plants, controllers and network laws, the built-in ones registered like a user's.

A kind with a colon is no entry point but a class of the user's own file, see :mod:`hil.plugins`.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import is_dataclass
from functools import cache
from typing import Final, Literal

from hil.errors import HilError, nearest
from hil.plugins import is_own, load_own, text_of, written_in
from transport.installed import Point, points, said_by

Group = Literal["hil.plants", "hil.controllers", "hil.laws", "hil.links", "hil.measures"]

OBJECT: Final = "object "
"""How the kind of something begins that was built in Python and stands in no file."""


MEANT: Final[dict[Group, dict[str, tuple[str, ...]]]] = {
    "hil.plants": {
        "state-space": ("linear", "lti", "ss", "abcd", "matrix", "matrices"),
        "transfer-function": ("tf", "zpk", "siso", "polynomial"),
        "fmu": ("fmi", "simulink", "modelica"),
        "omni": ("haptic", "phantom"),
    },
    "hil.controllers": {
        "output-feedback": ("kalman", "observer", "dynamic", "pi", "pid", "state-space"),
        "local-designed": ("lqr", "lqg"),
        "send-all": ("gain", "gains", "static", "matrix"),
        "virtual-wall": ("wall", "haptic"),
    },
    "hil.laws": {
        "packet": ("bernoulli", "loss", "jitter", "latency"),
        "iid": ("independent", "random"),
        "constant": ("fixed", "none", "ideal"),
        "trace": ("recorded", "file"),
    },
}
"""Words of the field for what a kind is, where its name is spelt otherwise."""


@cache
def _found() -> dict[str, dict[str, Point]]:
    found: dict[str, dict[str, Point]] = {}
    for point in points("hil."):
        found.setdefault(point.group, {})[point.name] = point
    return found


def _of(group: Group) -> dict[str, Point]:
    return _found().get(group, {})


def names(group: Group) -> list[str]:
    """Return the names of every plug-in of a group, sorted.

    >>> "dc-motor" in names("hil.plants")
    True
    """
    return sorted(_of(group))


def load(group: Group, name: str, folder: str = ".") -> type:
    """Return the parameter class of one plug-in.

    Args:
        group: what it is.
        name: its entry point, or ``module:Class`` of a file in the folder.
        folder: where the experiment stands.

    Raises:
        HilError: if no such plug-in is installed (the message names the nearest), or it cannot be loaded, whatever it raises.
    """
    if is_own(name):
        own: type = load_own(name, folder)
        return own
    found = _of(group)
    if name not in found:
        there = f"(there are: {', '.join(sorted(found))})"
        raise HilError(f"no {group[4:-1]} plug-in is called {name!r}{_hint(group, name, found)} {there}")
    try:
        plugin: type = found[name].load()
    except KeyboardInterrupt:
        raise
    except BaseException as e:
        raise HilError(f"{group[4:-1]} plug-in {found[name]}, cannot be loaded: {type(e).__name__}: {text_of(e)}") from e
    return plugin


def _hint(group: Group, name: str, found: dict[str, Point]) -> str:
    word = name.lower().replace("_", "-")
    meant = (kind for kind, words in MEANT.get(group, {}).items() if word in words and kind in found)
    return next((f"; did you mean {kind!r}?" for kind in meant), "") or nearest(word, found)


def provider(group: Group, name: str) -> str:
    """Return the distribution that a plug-in comes from, for `hil doctor` and for provenance."""
    if is_own(name):
        return name.partition(":")[0].replace(".", "/") + ".py"
    return said_by(_of(group)[name].package, "Name") or "?"


def group_of(path: str) -> Group:
    """Return the group of what a table makes, by its path: the plant, the controller, or a network law."""
    return "hil.plants" if path == "plant" else "hil.controllers" if path == "controller" else "hil.laws"


def kind_of(group: Group, kind: str, plugin: object) -> str:
    """Return the kind that a log may give an object: what its table said if that made it, else that it is an object of Python.

    Args:
        group: of the plug-in.
        kind: what the table said.
        plugin: what stands there now.
    """
    cls = type(plugin)
    if is_own(kind):
        return kind if written_in(cls) is not None and cls.__qualname__ == kind.partition(":")[2] else object_kind(cls)
    named = load(group, kind) if kind in _of(group) else None
    return object_kind(cls) if isinstance(named, type) and named is not cls else kind


def object_kind(cls: type) -> str:
    """Return the kind of an object that no table made: ``object my_module.Cart``."""
    return f"{OBJECT}{cls.__module__}.{cls.__qualname__}"


def kind_of_class(group: Group, cls: type) -> str | None:
    """Return the entry point of a dataclass, None if it has none, or is no dataclass: its table could not make it again."""
    if not is_dataclass(cls):
        return None
    for name, point in _of(group).items():
        with suppress(HilError):  # one that cannot be loaded is none of this class
            if point.value.partition(":")[2] == cls.__qualname__ and load(group, name) is cls:
                return name
    return None
