"""Every statement of every chapter, as its table has it: what is said, what is printed, and numbers by name."""

from __future__ import annotations

import importlib
import pkgutil
import re
from collections.abc import Iterator

import pytest

import hil.thesis
from hil.thesis.statements import Statement

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
