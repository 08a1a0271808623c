"""``hil guide``: the pages of the guide, on the terminal."""

from __future__ import annotations

import re
from importlib import resources
from pathlib import Path

import click

from hil.errors import HilError, nearest

ORDER = (
    "quick-start", "experiments", "first-plugin", "own-plant-law-controller", "wire-format", "who-commands", "real-time",
    "live", "vcan", "ci", "performance", "figures", "faults", "logs-and-reports", "designs-and-certificates", "haptic-walls",
    "several-sensors", "can-bus", "identification", "networks", "reproducing-the-thesis", "errata", "glossary", "architecture",
    "decisions",
)  # fmt: skip
"""Topics in reading order; a page that is not named here comes last."""


def pages() -> dict[str, Path]:
    """Return the pages that come with the package, by topic, in reading order."""
    found = {p.stem: p for p in Path(str(resources.files("hil") / "guide")).glob("*.md") if p.stem != "index"}
    return {name: found[name] for name in sorted(found, key=lambda n: (ORDER.index(n) if n in ORDER else len(ORDER), n))}


def _topics(_ctx: click.Context, _param: click.Parameter, incomplete: str) -> list[str]:
    return [name for name in pages() if name.startswith(incomplete)]


def _near(topic: str, found: dict[str, Path]) -> str:
    """The page whose name is near, else those that speak of it."""
    if said := nearest(topic, found):
        return said
    word = re.compile(rf"\b{re.escape(topic[:60])}\b", re.IGNORECASE)
    speak = {name: len(word.findall(path.read_text(encoding="utf-8"))) for name, path in found.items()}
    most = sorted((name for name in speak if speak[name]), key=lambda name: -speak[name])[:3]
    return f"; it stands in: {', '.join(most)};" if most else nearest(topic, found, cutoff=0.4)


@click.command()
@click.argument("topic", required=False, shell_complete=_topics)
def command(topic: str | None) -> None:
    """Show the guide's page on TOPIC, in a pager ($PAGER, less) where it is long; without a topic, list them."""
    import sys

    found = pages()
    if topic is None:
        width = max(map(len, found))
        for name, path in found.items():
            print(f"{name:<{width}}  {path.read_text(encoding='utf-8').partition(chr(10))[0].removeprefix('# ')}")
        return
    if topic not in found:
        raise HilError(f"no topic {topic!r} in the guide{_near(topic, found) or ';'} `hil guide` lists them")
    text = found[topic].read_text(encoding="utf-8")
    if not sys.stdout.isatty():
        print(text, end="")
        return
    from rich.console import Console
    from rich.markdown import Markdown

    console = Console()
    with console.capture() as shown:
        console.print(Markdown(text))
    if shown.get().count("\n") < console.height:
        print(shown.get(), end="")
    else:
        click.echo_via_pager(shown.get(), color=not console.no_color)
