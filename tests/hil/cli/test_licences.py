"""The bill of materials names what is installed, and what its licence asks."""

from __future__ import annotations

import json
from importlib.metadata import distributions

import pytest

from tests.hil.cli.conftest import Hil


def test_every_installed_package_is_listed_with_its_licence(cli: Hil, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    status, out, _ = cli("licences", "--json")
    rows = {row["name"]: row for row in json.loads(out)["packages"]}
    assert status == 0 and len(rows) >= len({d.metadata["Name"] for d in distributions()}) - 1
    assert "LGPL" in rows["python-can"]["licence"] or "Lesser" in rows["python-can"]["licence"]
    assert rows["python-can"]["copyleft"] and rows["python-can"]["needed_by_hil"]
    assert not rows["numpy"]["copyleft"] and rows["numpy"]["needed_by_hil"] and not rows["pytest"]["needed_by_hil"]
    lines = cli("licences")[1].splitlines()
    assert lines[0].startswith("! ") and max(map(len, lines)) <= 80
