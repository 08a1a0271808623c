"""``hil guide``, ``hil licences``: the pages of the guide, on the terminal; and what is installed, under which licence.

The list of licences is what a bill of materials needs.
"""

from __future__ import annotations

import re
from importlib import resources
from importlib.metadata import Distribution, distribution, distributions
from pathlib import Path
from typing import Any

import click

from hil.cli.terminal import Line, answer, console, json_option, print_folded, print_lines
from hil.errors import HilError, nearest

ORDER = (
    "quick-start", "experiments", "first-plugin", "own-plant-law-controller", "own-messages", "wire-format", "authentication",
    "real-time", "live", "vcan", "ci", "performance", "figures", "faults", "logs-and-reports", "designs-and-certificates",
    "haptic-walls", "several-sensors", "can-bus", "identification", "networks", "reproducing-the-thesis", "errata", "glossary",
    "architecture", "decisions",
)  # fmt: skip
"""Topics in reading order; a page that is not named here comes last."""
COPYLEFT = re.compile(r"\bL?GPL|\bAGPL|Lesser General Public|\bMPL|Mozilla Public|\bEPL|Eclipse Public", re.IGNORECASE)


def pages() -> dict[str, Path]:
    """Return the pages that come with the package, by topic, in reading order."""
    found = {p.stem: p for p in Path(str(resources.files("hil") / "guide")).glob("*.md") if p.stem != "index"}
    return {name: found[name] for name in sorted(found, key=lambda n: (ORDER.index(n) if n in ORDER else len(ORDER), n))}


def _topics(_ctx: click.Context, _param: click.Parameter, incomplete: str) -> list[str]:
    return [name for name in pages() if name.startswith(incomplete)]


def _meant(topic: str, found: dict[str, Path]) -> str:
    """The page of this name, or the one in whose name it stands, in capitals or not.

    Raises:
        HilError: none, or several; it names them, else the page whose name is near, else those that name it.
    """
    lower = topic.lower()
    inside = [lower] if lower in found else [name for name in found if lower and lower in name]
    if len(inside) == 1:
        return inside[0]
    near = f"; it stands in the names {', '.join(inside)};" if inside else nearest(topic, found)
    if not near:
        word = re.compile(rf"\b{re.escape(topic[:60])}\b", re.IGNORECASE)
        counts = {name: len(word.findall(path.read_text(encoding="utf-8"))) for name, path in found.items()}
        most = sorted((name for name in counts if counts[name]), key=lambda name: -counts[name])[:3]
        near = f"; it stands in: {', '.join(most)};" if most else nearest(topic, found, cutoff=0.4)
    raise HilError(f"no topic {topic!r} in the guide{near or ';'} `hil guide` lists them")


@click.command()
@click.argument("topic", required=False, shell_complete=_topics)
def guide(topic: str | None) -> None:
    """Show the guide's page on TOPIC, in a pager ($PAGER, less) where it is long; without a topic, list them.

    A part of a name that no other has is enough: hil guide designs
    """
    import sys

    found = pages()
    if topic is None:
        width = max(map(len, found))
        for name, path in found.items():
            print(f"{name:<{width}}  {path.read_text(encoding='utf-8').partition(chr(10))[0].removeprefix('# ')}")
        return
    text = found[_meant(topic, found)].read_text(encoding="utf-8")
    if sys.stdout is None or not sys.stdout.isatty():
        print(text, end="")
        return
    from rich.markdown import Markdown

    out = console()
    with out.capture() as shown:
        out.print(Markdown(text))
    if shown.get().count("\n") < out.height:
        print(shown.get(), end="")
    else:
        click.echo_via_pager(shown.get(), color=not out.no_color)


@click.command()
@json_option()
def licences() -> None:
    """List every installed package with its version and licence; licences with conditions for redistribution come first."""
    rows = bill()
    answer({"packages": rows}, _show_licences, rows)


def _show_licences(rows: list[dict[str, Any]]) -> None:
    width = max(len(row["version"]) for row in rows)
    lines = []
    for row in sorted(rows, key=lambda row: (not row["copyleft"], row["name"])):
        mark, needed = "!" if row["copyleft"] else " ", "" if row["needed_by_hil"] else "  (tests)"
        lines.append(Line(f"{mark} {row['name']}", f"{row['version']:<{width}}  {row['licence']}{needed}"))
    print_lines(lines)
    print_folded("! a licence with conditions for who passes the package on: python-can is LGPL-3.0, which hil imports as it is")


def bill() -> list[dict[str, Any]]:
    """Return name, version and licence of every installed distribution, sorted by name, as the packages state them."""
    needed = _closure("hilrig")
    found = {_plain(d.metadata["Name"]): d for d in distributions()}
    return [
        {
            "name": name,
            "version": d.version,
            "licence": _licence(d),
            "copyleft": COPYLEFT.search(_licence(d)) is not None,
            "needed_by_hil": name in needed,
        }
        for name, d in sorted(found.items())
    ]


def _licence(d: Distribution) -> str:
    stated = d.metadata.get_all("License-Expression") or []
    words = stated[0] if stated else ""
    if not words:
        classes = [c.rpartition(" :: ")[2] for c in d.metadata.get_all("Classifier") or [] if c.startswith("License ::")]
        words = ", ".join(classes) or (d.metadata.get_all("License") or [""])[0].strip().partition("\n")[0]
    return words[:80] or "not stated"


def _closure(root: str) -> set[str]:
    """Names of what a distribution needs when it runs, directly or not; extras of it are for tests."""
    seen: set[str] = set()
    waiting = [root]
    while waiting:
        name = _plain(waiting.pop())
        if name in seen:
            continue
        try:
            requires = distribution(name).requires or []
        except ModuleNotFoundError:
            continue  # for another platform
        seen.add(name)
        extra = [line for line in requires if "extra ==" not in line]
        waiting += [match.group() for line in extra if (match := re.match(r"[A-Za-z0-9._-]+", line))]
    return seen


def _plain(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()
