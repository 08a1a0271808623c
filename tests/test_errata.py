"""Errata are numbered, each with witnesses that exist, and whoever cites one cites one that is there."""

from __future__ import annotations

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
ERRATA = ROOT / "design" / "as_printed" / "ERRATA.md"
ROOMS = ("hil", "design", "plants", "transport", "tests")


def items() -> dict[int, str]:
    """Text of every item by its number."""
    parts = re.split(r"^## (\d+)\. ", ERRATA.read_text(), flags=re.MULTILINE)[1:]
    return {int(number): text for number, text in zip(parts[::2], parts[1::2], strict=True)}


def citations() -> list[tuple[str, int]]:
    """Every ``ERRATA n`` of the code, with its file."""
    found = []
    for room in ROOMS:
        for path in sorted((ROOT / room).rglob("*.py")):
            if path != Path(__file__).resolve():
                for cited in re.findall(r"ERRATA (\d+(?:(?:, | and |, and | to )\d+)*)", path.read_text()):
                    found += [(str(path.relative_to(ROOT)), int(number)) for number in re.findall(r"\d+", cited)]
    return found


def test_items_are_numbered_without_a_gap_and_say_what_is_printed_and_what_is_right() -> None:
    found = items()
    assert list(found) == list(range(1, len(found) + 1)) and len(found) >= 18
    for number, text in found.items():
        assert "- Printed: " in text and "- Right: " in text and "- Witness: " in text, number


def test_every_witness_is_a_test_that_exists() -> None:
    for number, text in items().items():
        for witness in re.findall(r"^- Witness: (\S+)$", text, flags=re.MULTILINE):
            name, _, test = witness.partition("::")
            tree = ast.parse((ROOT / name).read_text())
            tests = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
            assert test.startswith("test_") and test in tests, f"item {number}: {witness}"


def test_every_cited_item_exists() -> None:
    cited = citations()
    assert len(cited) > 10
    known = set(items())
    assert not [(path, number) for path, number in cited if number not in known]


def test_no_file_cites_a_document_that_is_not_here() -> None:
    gone = re.compile(r"\bfindings\b", re.IGNORECASE)
    for room in ("hil", "design", "plants", "transport", "tests"):
        for path in sorted((ROOT / room).rglob("*.py")):
            assert path == Path(__file__) or not gone.search(path.read_text()), path
