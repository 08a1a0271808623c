"""The guide's table of places of the thesis: every row, experiment and command that it names is there."""

from __future__ import annotations

import re
import shlex

import click
import pytest

from hil.cli import cli
from hil.cli.guide import pages
from hil.experiment import shipped
from tests.hil.thesis.test_statements import every_statement

PAGE = pages()["reproducing-the-thesis"].read_text(encoding="utf-8")
TABLE = re.findall(r"^\| (.+?) \| (.+?) \|$", PAGE.partition("## Place by place")[2].partition("\n\nThe ratios")[0], re.M)[1:]
NAMED = [(place, name) for place, answer in TABLE for name in re.findall(r"`([^`]+)`", answer)]


@pytest.fixture(scope="module")
def items() -> list[str]:
    """Every statement, as the guide names it: ``ch3: Lemma 3.1 ...``."""
    return [f"ch{room.split('.chapter', 1)[1][0]}: {each.item}" for room, each in every_statement()]


def test_every_place_has_an_answer() -> None:
    assert len(TABLE) > 20 and all("`" in answer for _, answer in TABLE)


@pytest.mark.parametrize(("place", "name"), NAMED)
def test_what_the_table_names_is_there(place: str, name: str, items: list[str]) -> None:
    if re.match(r"ch\d: ", name):
        assert any(item.startswith(name) for item in items), place
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
