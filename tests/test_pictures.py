"""The pictures of README and guide: there, small, and named where they are shown; the wheel has none of them."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

from tests.pictures import COLOURS

ROOT = Path(__file__).parents[1]


def test_every_picture_that_is_shown_is_there_and_small() -> None:
    pages = (ROOT / "README.md", ROOT / "hil/guide/live.md")
    shown = {page: re.findall(r"!\[[^\]]+\]\(([^)]+)\)", page.read_text()) for page in pages}
    files = [page.parent / name for page, names in shown.items() for name in names if name.endswith(".png")]
    assert {file.name for file in files} == {"README.png", "live.png", "live-walls.png", "live-phone.png"} and len(files) == 5
    for file in files:
        data = file.read_bytes()
        assert data.startswith(b"\x89PNG") and len(data) <= 100_000, file
        assert data[25] == 3, f"{file}: a palette of {COLOURS} colours"
    wheel = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["hatch"]["build"]["targets"]["wheel"]
    assert wheel["exclude"] == ["hil/guide/*.png"]
