"""``hil licences``: what is installed beside hilrig, and under which licence; the list that a bill of materials needs."""

from __future__ import annotations

import re
from importlib.metadata import Distribution, distribution, distributions
from typing import Any

import click

from hil.cli.terminal import json_option, print_json

COPYLEFT = re.compile(r"\bL?GPL|\bAGPL|Lesser General Public|\bMPL|Mozilla Public|\bEPL|Eclipse Public", re.IGNORECASE)


@click.command()
@json_option()
def command(as_json: bool) -> None:
    """List every installed package with its version and licence; those that ask something of who passes them on come first."""
    rows = bill()
    if as_json:
        print_json({"packages": rows})
        return
    width = max(len(row["name"]) for row in rows)
    for row in sorted(rows, key=lambda row: (not row["copyleft"], row["name"])):
        mark = "!" if row["copyleft"] else " "
        needed = "" if row["needed_by_hil"] else "  (tests)"
        print(f"{mark} {row['name']:<{width}}  {row['version']:<14}  {row['licence']}{needed}")
    print("! a licence with conditions for who passes the package on: python-can is LGPL-3.0, imported and not changed by hil")


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
