"""The guide's page of the architecture draws the rooms that are there, and names files that are there."""

from __future__ import annotations

import re

from tests.rooms import PAGE, ROOT, page


def test_the_rooms_are_those_of_the_imports() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), "rooms have changed: python -m tests.rooms"


def test_every_path_of_the_page_is_there() -> None:
    text = PAGE.read_text(encoding="utf-8")
    named = re.findall(r"(?:hil|tests|plants|transport|design)/[\w/.]*\w", text)
    paths = {path.replace("chapterN", "chapter7") for path in named}
    assert len(paths) > 15
    assert not sorted(path for path in paths if not (ROOT / path).exists())
