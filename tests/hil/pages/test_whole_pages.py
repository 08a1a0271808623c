"""Whole pages against what they were: every text and every line that is drawn, of fixed numbers and of short runs.

``python -m tests.hil.pages.test_whole_pages`` writes ``tests/data/pages.json`` anew, a digest of each line of each section.
A test that fails says which section differs, and its lines that are new: look at the page in a browser before it is written.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from difflib import SequenceMatcher
from functools import partial
from pathlib import Path
from typing import Final

import pytest

from tests.hil.pages.number_pages import designs, many_runs, results
from tests.hil.pages.runs import RUNS, folder, in_time, live, run_page
from tests.hil.pages.whole_pages import digests, every_block, paper

FILE = Path(__file__).parents[2] / "data" / "pages.json"
WRITTEN = json.loads(FILE.read_text()) if FILE.exists() else {}
SHOWN = 12
PAGES: Final[dict[str, Callable[[], dict[str, list[str]]]]] = {
    "every block": every_block, "paper": paper, "many runs": many_runs, "results": results, "designs": designs, "folder": folder,
    "in time": in_time, "live": live, **{name: partial(run_page, name) for name in RUNS},
}  # fmt: skip


@pytest.mark.parametrize("name", PAGES)
def test_a_page_is_what_it_was(name: str) -> None:
    found, written = PAGES[name](), WRITTEN[name]
    said = []
    for section in {**written, **found}:
        new, old = found.get(section, []), re.findall("...", written.get(section, ""))
        for kind, i, end, j, stop in SequenceMatcher(None, old, digests(new), autojunk=False).get_opcodes():
            if kind != "equal":
                said += [f"{section}: {end - i} lines were where line {j} is now:", *(f"    {line}" for line in new[j:stop])]
    assert not said, "\n".join([*said[:SHOWN], f"{len(said)} lines in all; if they are meant: python -m {__name__}"])


if __name__ == "__main__":
    pages = {name: {section: "".join(digests(own)) for section, own in page().items()} for name, page in PAGES.items()}
    FILE.write_text(json.dumps(pages, indent=0, ensure_ascii=False) + "\n")
