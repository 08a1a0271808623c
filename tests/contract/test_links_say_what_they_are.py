"""No file outside `transport/links` reads the text of a link's URI: what a link is, it says itself (`transport.links.traits`)."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

TOP = Path(__file__).parents[2]
SCHEME = re.compile(r"(can|zenoh|memory|local|plain-[a-z]+):?")
CUTTING = {"partition", "rpartition", "split", "rsplit", "startswith", "removeprefix", "find", "index"}
WORDS = re.compile(r"""\b(uri|link|template|scheme)\b|transport\.links|urllib|[a-z]:["']""")
"""What a file holds that reads one: of the others no tree is made."""
READERS = {"split_uri", "LOCAL", "FORMS", "parse_qsl", "urlparse", "urlsplit"}


def readings(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Give line and reason of each place that reads what a URI says."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            from_links = (node.module or "").startswith(("transport.links", "urllib"))
            yield from ((node.lineno, f"imports {name.name}") for name in node.names if from_links and name.name in READERS)
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in CUTTING:
            of = ast.unparse(node.func.value)
            texts = [arg.value for arg in ast.walk(node) if isinstance(arg, ast.Constant) and isinstance(arg.value, str)]
            if re.search(r"\b(uri|link|template)\b", of) or any(SCHEME.fullmatch(text) and text.endswith(":") for text in texts):
                yield node.lineno, ast.unparse(node)
        elif isinstance(node, ast.Compare):
            sides = [node.left, *node.comparators]
            named = any(re.search(r"\b(uri|scheme)\b", ast.unparse(side)) for side in sides)
            if named and any(isinstance(side, ast.Constant) and SCHEME.match(str(side.value)) for side in sides):
                yield node.lineno, ast.unparse(node)
            if any(isinstance(op, ast.In) for op in node.ops) and re.search(r"\buri\b", ast.unparse(node.comparators[-1])):
                yield node.lineno, ast.unparse(node)


def test_only_links_read_the_text_of_a_uri() -> None:
    found = [
        f"{path.relative_to(TOP)}:{line}: {what}"
        for package in ("hil", "plants", "design", "transport")
        for path in sorted((TOP / package).rglob("*.py"))
        if not path.is_relative_to(TOP / "transport" / "links")
        if WORDS.search(text := path.read_text(encoding="utf-8"))
        for line, what in readings(ast.parse(text))
    ]
    assert not found, "\n".join(found)


@pytest.mark.parametrize(
    "line",
    [
        'uri.startswith("can:")', 'link.uri.partition(":")', 'x = job.uri == "local:"', 'name.removeprefix("zenoh:")',
        '"auth=" in uri', "from transport.links import split_uri", "from transport.links.contract import LOCAL",
        'scheme == "can"',
    ],
)  # fmt: skip
def test_a_reading_is_found(line: str) -> None:
    assert WORDS.search(line) and list(readings(ast.parse(line)))
