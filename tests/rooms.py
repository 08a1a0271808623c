"""The rooms of the house, drawn into the guide: ``python -m tests.rooms`` writes them into ``hil/guide/architecture.md``.

A floor holds the rooms that lean on nothing above it: the contracts of import-linter hold that no arrow runs back up. What is
drawn is computed from the imports themselves, not from the contracts.
"""

from __future__ import annotations

import ast
import textwrap
from pathlib import Path

import grimp

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "hil/guide/architecture.md"
BEGIN, END = "<!-- rooms: written by python -m tests.rooms -->", "<!-- end of rooms -->"
PACKAGES = ("hil", "plants", "transport", "design")


def floors(graph: grimp.ImportGraph, package: str) -> list[list[str]]:
    """Return the rooms of a package by floor, those that lean on no other room last."""
    rooms = {name for name in graph.find_children(package) if name.rpartition(".")[2] != "__main__"}
    below = {
        room: {
            other
            for other in rooms - {room}
            if any(graph.find_modules_directly_imported_by(module) & family(graph, other) for module in family(graph, room))
        }
        for room in rooms
    }
    height: dict[str, int] = {}

    def of(room: str, above: tuple[str, ...] = ()) -> int:
        if room in above:
            raise ValueError(f"a circle of rooms: {' -> '.join((*above, room))}")
        if room not in height:
            height[room] = 1 + max((of(other, (*above, room)) for other in below[room]), default=-1)
        return height[room]

    found: dict[int, list[str]] = {}
    for room in sorted(rooms):
        found.setdefault(of(room), []).append(room)
    return [found[floor] for floor in sorted(found, reverse=True)]


def family(graph: grimp.ImportGraph, module: str) -> set[str]:
    """Return a module and all that stand below it."""
    return {module} | graph.find_descendants(module)


def says(module: str) -> str:
    """Return the first line of a room's docstring."""
    path = ROOT / module.replace(".", "/")
    file = path.with_suffix(".py")
    file = file if file.exists() else path / "__init__.py"  # a folder that was a room may lie beside the file
    doc = (ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or "").partition("\n")[0]
    return doc.partition(". ")[0].replace("|", "/").replace("``", "`").rstrip(".")


def wrapped(item: str) -> str:
    """Return an item of a list, folded."""
    return textwrap.fill(item, 118, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False)


def drawn() -> str:
    """Return the lists of all rooms, as they stand in the page."""
    graph = grimp.build_graph(*PACKAGES, exclude_type_checking_imports=True, cache_dir=None)
    lines = []
    for package in PACKAGES:
        found = floors(graph, package)
        rooms = [room for floor in found for room in floor]
        lines += [f"\n### `{package}`: {len(rooms)} rooms on {len(found)} floors\n"]
        for height, floor in zip(range(len(found) - 1, -1, -1), found, strict=True):
            lines += [wrapped(f"- {height} `{room.partition('.')[2]}`: {says(room)}") for room in floor]
    return "\n".join(lines).strip() + "\n"


def page() -> str:
    """Return the page with the rooms as they are."""
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    return f"{before}{BEGIN}\n\n{drawn()}\n{END}{rest.partition(END)[2]}"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    print(PAGE)
