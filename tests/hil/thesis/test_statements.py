"""Every statement of every chapter, as its table has it: what is said, what is printed, and numbers by name.

``python -m tests.hil.thesis.test_statements`` writes them as they are now, for a reviewer to read what a change does to them.
"""

from __future__ import annotations

import importlib
import pkgutil
import re
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

import hil.thesis
from hil.thesis import Check
from hil.thesis.statements import Claim, Statement, judge
from tests.mutations.faults import ROOT

WRITTEN = Path(ROOT, "tests/data/statements.txt")

PLACE = re.compile(r"(Section|Figure|Table|Theorem|Example) [\d.]+[a-z]?")
NAME = re.compile(r"(local )?[\w-]+([.]\w+|\[[^\[\]]+\])*")


def statements(found: object) -> Iterator[Statement]:
    """Yield the statements of a table, or of tables by name."""
    if isinstance(found, Statement):
        yield found
    elif isinstance(found, dict | tuple | list):
        for each in found.values() if isinstance(found, dict) else found:
            yield from statements(each)


def every_statement() -> list[tuple[str, Statement]]:
    modules = [importlib.import_module(each.name) for each in pkgutil.walk_packages(hil.thesis.__path__, "hil.thesis.")]
    return [(module.__name__, each) for module in modules for value in vars(module).values() for each in statements(value)]


@pytest.fixture(scope="module")
def tables() -> list[tuple[str, Statement]]:
    return every_statement()


def test_a_statement_says_what_and_not_where(tables: list[tuple[str, Statement]]) -> None:
    assert len(tables) > 300
    assert [(room, each.item) for room, each in tables if not each.item.strip() or PLACE.fullmatch(each.item)] == []


def test_what_is_printed_fits_into_its_column_and_has_no_place_before_it(tables: list[tuple[str, Statement]]) -> None:
    assert [(room, each.item) for room, each in tables if ": " in each.printed or len(each.printed) > 50] == []
    assert sum(": " in each.item for _, each in tables) > 200


def test_what_is_claimed_has_the_name_of_a_number(tables: list[tuple[str, Statement]]) -> None:
    claims = [(room, each.item, c) for room, each in tables for c in (*each.claims, *each.witness, *each.beside)]
    assert len(claims) > 500
    assert [(room, item, c) for room, item, c in claims if isinstance(c.name, str) and not NAME.fullmatch(c.name)] == []


class Named(float):
    """A computed number of which only the name is known; words that quote it quote its name."""

    name: str
    seen: ClassVar[dict[str, str]] = {}

    def __new__(cls, name: str) -> Named:
        made = super().__new__(cls, 2.0 + zlib.crc32(name.encode()) / 1e10)
        made.name = cls.seen[f"{float(made):g}"] = name
        return made

    def __getitem__(self, key: object) -> Named:
        return Named(f"{self.name}[{key}]")

    def __getattr__(self, part: str) -> Named:
        if part.startswith("__"):
            raise AttributeError(part)
        return Named(f"{self.name}.{part}")

    def __format__(self, spec: str) -> str:
        return f"{{{self.name}{spec and ':' + spec}}}"

    def __str__(self) -> str:
        return format(self)

    def __array__(self, *_: object, **__: object) -> np.ndarray:
        return np.array([float(self)])


class Names(dict[str, Any]):
    """Computed numbers, whatever is asked for."""

    def __missing__(self, name: str) -> Named:
        return Named(name)


def as_written() -> Iterator[str]:
    """Yield every chapter, stage and statement, with the rules of its numbers, as lines."""
    for name in hil.thesis.chapters():
        chapter = importlib.import_module(f"hil.thesis.chapter{name[2:]}").CHAPTER
        yield f"# {chapter.title}"
        for stage in chapter.stages:
            yield f"## {stage.title}: {stage.seconds:g} s"
            for each in stage.statements:
                (row,) = judge([each], Names())
                yield f"{row.item}\n  printed: {row.printed}\n  computed: {each.computed and row.computed}\n  basis: {row.basis}"
                yield from rules("holds where each reading says so" if row.readings else "holds where", each.claims, row.checks)
                yield from rules("refuted where", each.witness, row.witness)
                yield from rules("beside", each.beside, row.beside)


def rules(where: str, claims: tuple[Claim, ...], checks: tuple[Check, ...]) -> Iterator[str]:
    for claim, check in zip(claims, checks, strict=True):
        rule = re.sub(r"2\.\d+", lambda number: Named.seen.get(number[0], number[0]), str(check.rule))
        yield f"  {where}: {check.what} ({claim.name}) {rule}"


def test_statements_are_as_they_were() -> None:
    assert WRITTEN.read_text(encoding="utf-8").splitlines() == "\n".join(as_written()).splitlines()


if __name__ == "__main__":
    WRITTEN.write_text("\n".join(as_written()) + "\n", encoding="utf-8")
