"""The gallery of the guide: each experiment with its picture, its certificate and the command that makes it."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests import gallery


def test_an_experiment_has_picture_certificate_and_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("matplotlib")
    said = {"dc-motor-hinf": ("certified", ""), "omni-theorem61": ("refused", " --set allow_uncertified=true")}
    monkeypatch.setattr(gallery, "shipped", lambda: said)
    assert gallery.main(str(tmp_path)) == 0
    page = (tmp_path / "gallery.md").read_text()
    for name, (state, also) in said.items():
        (part,) = (part for part in page.split("\n## ") if part.startswith(f"{name}\n"))
        assert f"**{state}**: " in part and f"$ hil run {name}{also}\n" in part
        assert (tmp_path / "gallery" / f"{name}.svg").read_text().lstrip().startswith("<?xml")
