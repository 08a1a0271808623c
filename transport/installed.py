"""What is installed: packages by their folders on the path, their versions and entry points.

`importlib.metadata` says the same, and reads a package's page as an email: its import alone takes a tenth of a short run. It is
asked only where a package may lie elsewhere than in a folder of the path: in an archive, or with a finder of its own.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterable, Iterator
from functools import reduce
from importlib import import_module
from importlib.machinery import PathFinder
from typing import Any, Final, NamedTuple, Protocol

PAGES: Final = ("METADATA", "PKG-INFO")
"""Where a wheel, and where an egg, states its name and version."""


class Point(NamedTuple):
    """One entry point of a package: ``name = module:attribute`` below ``[group]``."""

    group: str
    name: str
    value: str
    package: Package

    def load(self) -> Any:
        """Return what it names.

        Raises:
            ImportError, AttributeError: there is no such module or attribute.
            BaseException: whatever the module raises.
        """
        module, _, attribute = self.value.partition("[")[0].partition(":")
        return reduce(getattr, filter(None, attribute.strip().split(".")), import_module(module.strip()))

    def __str__(self) -> str:
        return f"{self.name} = {self.value}, of the package {said_by(self.package, 'Name') or '?'}"


class Package(Protocol):
    """One that is installed."""

    def read_text(self, filename: str, /) -> str | None:
        """Return a file of what it says of itself, None where it has none."""


class Folder(NamedTuple):
    """A package by its folder ``NAME-VERSION.dist-info`` or ``NAME.egg-info``."""

    path: str

    def read_text(self, filename: str, /) -> str | None:
        """Return a file of the folder, None where it has none."""
        try:
            with open(os.path.join(self.path, filename), "rb", buffering=0) as file:  # every package's, at each start
                return file.readall().decode(errors="replace")
        except OSError:
            return None


def packages() -> Iterator[tuple[str, Package]]:
    """Yield every package with its name as it stands there, see `_plain`, in the order of the path."""
    if _elsewhere():
        from importlib.metadata import distributions

        yield from ((each.name, each) for each in distributions())
        return
    for entry in dict.fromkeys(sys.path):
        try:
            names = os.listdir(entry or ".")
        except OSError:
            continue
        for name in names:
            if name.endswith((".dist-info", ".egg-info")):
                yield name.rpartition(".")[0].partition("-")[0], Folder(os.path.join(entry, name))


def points(begin: str) -> tuple[Point, ...]:
    """Return the entry points of all groups that begin so; of two packages of one name, those of the first on the path."""
    first: dict[str, tuple[str, Package]] = {}
    for name, package in packages():
        if (own := _plain(name)) not in first:
            first[own] = package.read_text("entry_points.txt") or "", package
    some = [(said, package) for said, package in first.values() if f"[{begin}" in said]
    return tuple(point for said, package in some for point in _read(said, package) if point.group.startswith(begin))


def versions_of(names: Iterable[str]) -> dict[str, str]:
    """Return the versions of packages by their names as they are given; what is not installed is left out."""
    wanted = {_plain(name): name for name in names}
    first: dict[str, Package] = {}
    for name, package in packages():
        if (own := _plain(name)) in wanted:
            first.setdefault(wanted[own], package)
    return {name: said_by(package, "Version") for name, package in first.items()}


def said_by(package: Package, field: str) -> str:
    """Return a field of the head of a package's page, such as its name; empty where it has none."""
    page = next((text for text in map(package.read_text, PAGES) if text), "")
    return f"\n{page}".partition(f"\n{field}:")[2].partition("\n")[0].strip()


def _read(said: str, package: Package) -> Iterator[Point]:
    group = ""
    for line in map(str.strip, said.splitlines()):
        if line.startswith("["):
            group = line.strip("[] ")
        elif line and not line.startswith("#"):
            name, _, value = line.partition("=")
            yield Point(group, name.strip(), value.strip(), package)


def _elsewhere() -> bool:
    """Return whether a package may lie elsewhere than in a folder of the path."""
    own = any(finder is not PathFinder and hasattr(finder, "find_distributions") for finder in sys.meta_path)
    return own or any(os.path.isfile(entry) for entry in sys.path)


def _plain(name: str) -> str:
    """Return the name under which a package is looked for, as pip compares names."""
    return re.sub(r"[-_.]+", "-", name).lower()
