"""The gallery of the guide: each experiment with its picture, its certificate and the command that makes it."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests import gallery


def test_an_experiment_has_picture_certificate_and_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("matplotlib")
    monkeypatch.setattr(gallery, "shipped", lambda: ("omni-slide", "dc-motor-local"))
    assert gallery.main(str(tmp_path)) == 0
    page = (tmp_path / "gallery.md").read_text()
    for name in ("omni-slide", "dc-motor-local"):
        assert f"## {name}\n" in page and f"$ hil run {name}" in page
        assert (tmp_path / "gallery" / f"{name}.svg").read_text().lstrip().startswith("<?xml")
    assert "**certified**: " in page
