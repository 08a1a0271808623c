"""Docstrings can be read by a machine: `hil schema` takes what it says of a key from them."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest
from docstring_parser import ParseError
from docstring_parser.google import parse

import design
import hil
import plants
import transport

SECTION = re.compile(r"^\w+:$", re.M)
"""What of a docstring names or explains something; the others have no form."""
Documented = ast.FunctionDef | ast.ClassDef


def documented(path: Path) -> Iterator[tuple[Documented, str]]:
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and (text := ast.get_docstring(node)) and SECTION.search(text):
            yield node, text


def parameters(node: Documented) -> set[str]:
    """Everything that the docstring's Args and Attributes may name."""
    if isinstance(node, ast.ClassDef):
        fields = {s.target.id for s in node.body if isinstance(s, ast.AnnAssign) and isinstance(s.target, ast.Name)}
        methods = [s for s in node.body if isinstance(s, ast.FunctionDef)]
        reads = (t for m in methods for t in ast.walk(m) if isinstance(t, ast.Attribute) and isinstance(t.value, ast.Name))
        own = {t.attr for t in reads if isinstance(t.value, ast.Name) and t.value.id == "self"}
        given = {name for m in methods if m.name == "__init__" for name in parameters(m)}
        return fields | own | given | {m.name for m in methods}
    a = node.args
    return {each.arg for each in (*a.posonlyargs, *a.args, *a.kwonlyargs, *filter(None, (a.vararg, a.kwarg)))}


def wrong(node: Documented, text: str) -> str:
    """What is wrong with a docstring; nothing: an empty text."""
    try:
        named = {name.strip(" *") for param in parse(text).params for name in param.arg_name.split(",")}
    except ParseError as error:
        return str(error)
    gone = sorted(named - parameters(node))
    return f"has no {gone}" if gone and not (isinstance(node, ast.ClassDef) and node.bases) else ""  # a base may have it


WORDS = "nobody somebody someone anybody everybody strangers? told heard hears? speaks? talkers? honest"
PERSONS = re.compile(rf"\b(?:{WORDS.replace(' ', '|')}|who looks)\b", re.I)
"""Words for who is meant; the glossary has the names: rig, controller, node, program, user."""


@pytest.mark.parametrize("package", [design, hil, plants, transport], ids=lambda package: package.__name__)
def test_docstrings_have_the_form_and_the_words_of_the_glossary_and_name_what_is_there(package: ModuleType) -> None:
    files = sorted(Path(package.__path__[0]).rglob("*.py"))
    assert files
    found = ((path, node.name, wrong(node, text)) for path in files for node, text in documented(path))
    assert [f"{path}: {name}: {why}" for path, name, why in found if why] == []
    texts = ((path, node.value) for path in files for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Expr))
    said = [(path, text.value) for path, text in texts if isinstance(text, ast.Constant) and isinstance(text.value, str)]
    assert [f"{path}: {text:.80}" for path, text in said if PERSONS.search(text)] == []
