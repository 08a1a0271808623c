"""Every statement of every chapter, as its table has it: what is said, what is printed, and numbers by name.

``python -m tests.hil.thesis.test_statements`` writes them as they are now, for a reviewer to read what a change does to them.
"""

from __future__ import annotations

import ast
import importlib
import re
import shlex
import zlib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar

import click
import numpy as np
import pytest
from msgspec.structs import replace

import hil.thesis
from hil.cli import cli
from hil.cli.guide import pages
from hil.experiment import shipped
from hil.thesis import Chapter
from hil.thesis.judgement import VERDICTS, Check, Equals
from hil.thesis.statements import Claim, Statement, judge
from tests.hil.thesis.judging import assert_every_number_decides
from tests.mutations.faults import ROOT

PLACE = re.compile(r"(Section|Figure|Table|Theorem|Example) [\d.]+[a-z]?")
NAME = re.compile(r"(local )?[\w-]+([.]\w+|\[[^\[\]]+\])*")


ROOM = Path(hil.thesis.__file__).parent
WRITTEN = Path(ROOT, "tests/data/statements.txt")
PAGE = pages()["reproducing-the-thesis"].read_text(encoding="utf-8")
TABLE = re.findall(r"^\| (.+?) \| (.+?) \|$", PAGE.partition("## Place by place")[2].partition("\n\nThe ratios")[0], re.M)[1:]
NAMED = [(place, name) for place, answer in TABLE for name in re.findall(r"`([^`]+)`", answer)]
"""What the guide's table of places of the thesis names: rows, experiments and commands."""


def chapter_of(name: str) -> Chapter:
    found: Chapter = importlib.import_module(f"hil.thesis.chapter{name[2:]}").CHAPTER
    return found


@pytest.fixture(scope="module")
def tables() -> list[tuple[str, Statement]]:
    """Every statement, and the name of its chapter."""
    return [(name, each) for name in hil.thesis.chapters() for stage in chapter_of(name).stages for each in stage.statements]


def test_a_statement_says_what_and_not_where(tables: list[tuple[str, Statement]]) -> None:
    assert len(tables) > 200
    assert [(room, each.item) for room, each in tables if not each.item.strip() or PLACE.fullmatch(each.item)] == []


def test_what_is_printed_fits_into_its_column_and_has_no_place_before_it(tables: list[tuple[str, Statement]]) -> None:
    assert [(room, each.item) for room, each in tables if ": " in each.printed or len(each.printed) > 50] == []
    assert sum(": " in each.item for _, each in tables) > 100


def test_what_is_claimed_has_the_name_of_a_number(tables: list[tuple[str, Statement]]) -> None:
    claims = [(room, each.item, c) for room, each in tables for c in (*each.claims, *each.witness, *each.beside)]
    assert len(claims) > 400
    assert [(room, item, c) for room, item, c in claims if isinstance(c.name, str) and not NAME.fullmatch(c.name)] == []


def test_no_statement_is_given_a_verdict_and_each_is_judged_by_computed_numbers(tables: list[tuple[str, Statement]]) -> None:
    ours = set(VERDICTS) - {"undecided"}  # which certificates say too
    for path in sorted(ROOM.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and path.name not in ("judgement.py", "pages.py"):
                assert node.value not in ours, f"{path.name}:{node.lineno} writes a verdict down"
    for _, said in tables:
        with pytest.raises(KeyError):  # each number is asked for by its name
            judge([said], {})


def test_a_printed_number_is_judged_once(tables: list[tuple[str, Statement]]) -> None:
    """No two rows judge the same printed number: what else is known of it stands beside."""
    numbers = Counter(s.printed for _, s in tables if any(c.isdigit() for c in s.printed) and "." in s.printed)
    shared = {printed for printed, count in numbers.items() if count > 1}
    assert not {p for p in shared if not p.startswith(("Section", "Remark", "Figure", "more effective", "<", ">"))}, shared


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
        yield f"# {chapter_of(name).title}"
        for stage in chapter_of(name).stages:
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
    """Each limit, tolerance and side of every rule among them."""
    assert WRITTEN.read_text(encoding="utf-8").splitlines() == "\n".join(as_written()).splitlines()


def test_every_number_of_every_statement_turns_its_row_alone() -> None:
    def with_word(check: Check) -> Check:
        return replace(check, value=check.rule.word) if isinstance(check.rule, Equals) else check

    for name in hil.thesis.chapters():
        for row in judge([each for stage in chapter_of(name).stages for each in stage.statements], Names()):
            checks, witness = (tuple(map(with_word, each)) for each in (row.checks, row.witness))
            assert_every_number_decides([replace(row, checks=checks, witness=witness)])


def test_every_place_has_an_answer() -> None:
    assert len(TABLE) > 20 and all("`" in answer for _, answer in TABLE)


@pytest.mark.parametrize(("place", "name"), NAMED)
def test_what_the_table_names_is_there(place: str, name: str, tables: list[tuple[str, Statement]]) -> None:
    if re.match(r"ch\d: ", name):
        assert any(f"{chapter}: {each.item}".startswith(name) for chapter, each in tables), place
    elif name.startswith("hil "):
        words = shlex.split(name)[1:]
        command = cli.get_command(click.Context(cli), words[0])
        assert command is not None
        while isinstance(command, click.Group):
            words = words[1:]
            command = command.get_command(click.Context(cli), words[0])
            assert command is not None, place
        command.make_context(words[0], words[1:])
    else:
        assert name in shipped() or name == "[controller]", place


if __name__ == "__main__":
    WRITTEN.write_text("\n".join(as_written()) + "\n", encoding="utf-8")
