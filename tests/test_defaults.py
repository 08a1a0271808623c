"""An experiment that leaves a key out means what it meant: the defaults of every table stand in one file of the tests.

``python -m tests.test_defaults`` writes it anew, `tests/data/defaults.json`; a default that changes changes what files say.
"""

from __future__ import annotations

import json
import typing
from collections.abc import Iterator
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any

import msgspec

from hil.experiment import Experiment
from hil.plugins import registry
from hil.plugins.fields import fields_of

FILE = Path(__file__).parent / "data" / "defaults.json"
GROUPS: tuple[registry.Group, ...] = ("hil.plants", "hil.controllers", "hil.laws", "hil.measures")


def tables(hint: Any, seen: set[type]) -> Iterator[type]:
    """Yield the tables that a type is made of, and those inside of them."""
    for part in typing.get_args(hint):
        yield from tables(part, seen)
    if isinstance(hint, type) and hint not in seen and (is_dataclass(hint) or issubclass(hint, msgspec.Struct)):
        seen.add(hint)
        yield hint
        for own in typing.get_type_hints(hint).values():
            yield from tables(own, seen)


def found() -> dict[str, dict[str, str]]:
    """Return the defaults of every table that an experiment may have, as a file writes them; those that are nothing left out."""
    ours = [registry.load(group, name) for group in GROUPS for name in registry.names(group)
            if registry.provider(group, name) == "hilrig"]  # fmt: skip
    seen: set[type] = set()
    every = [table for cls in (Experiment, *ours) for table in tables(cls, seen)]
    said = {
        f"{cls.__module__}.{cls.__qualname__}": {
            field.name: field.default for field in fields_of(cls) if field.default not in ("", "None", "[]", '""', "''", "{}")
        }
        for cls in every
    }
    return {name: defaults for name, defaults in sorted(said.items()) if defaults}


def test_what_is_left_out_means_what_it_meant() -> None:
    written = json.loads(FILE.read_text())
    now = found()
    assert [name for name in {**written, **now} if now.get(name) != written.get(name)] == []


if __name__ == "__main__":
    FILE.write_text(json.dumps(found(), indent=1) + "\n")
