"""What is installed, read from the folders of the path: what `importlib.metadata` says, without its import."""

from __future__ import annotations

import json
import sys
import zipfile
from importlib.metadata import distributions
from pathlib import Path

import pytest

from transport.installed import points, said_by, versions_of

INFO = {
    "METADATA": "Metadata-Version: 2.1\nName: Rising_Tank\nVersion: 1.5\n\nA page.\nVersion: 9\n",
    "entry_points.txt": "[hil.plants]\n# ours\ntank = rising.tank:Tank.of [extra]\nlog=json:dumps\n\n[other]\nx = y:z\n",
}


def written(folder: Path, name: str) -> None:
    (folder / name).mkdir(parents=True)
    for file, text in INFO.items():
        (folder / name / file).write_text(text)


def test_every_package_has_the_version_and_entry_points_that_importlib_says() -> None:
    first: dict[str, str] = {}
    for each in distributions():
        first.setdefault(each.name.lower().replace("_", "-").replace(".", "-"), each.version)
    assert len(first) > 20 and versions_of(first) == first
    said = {(e.group, e.name, e.value) for e in points("hil.")}
    reported = {(e.group, e.name, e.value) for each in distributions() for e in each.entry_points if e.group.startswith("hil.")}
    assert said == reported and {group for group, _, _ in said} >= {"hil.plants", "hil.controllers", "hil.laws", "hil.links"}


@pytest.mark.parametrize("folder", ["rising_tank-1.5.dist-info", "rising_tank.egg-info", "Rising.Tank-1.5.dist-info"])
def test_a_package_of_a_folder_on_the_path_is_found(folder: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written(tmp_path, folder)
    monkeypatch.syspath_prepend(str(tmp_path))
    assert versions_of(["rising-tank"]) == {"rising-tank": "1.5"}
    mine = {p.name: p for p in points("hil.") if said_by(p.package, "Name") == "Rising_Tank"}
    assert {p.group for p in mine.values()} == {"hil.plants"}
    assert [p.value for p in mine.values()] == ["rising.tank:Tank.of [extra]", "json:dumps"]
    assert mine["log"].load() is json.dumps
    with pytest.raises(ImportError):
        mine["tank"].load()


def test_of_two_packages_of_one_name_the_first_on_the_path_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for place in ("a", "b"):
        written(tmp_path / place, "rising_tank-1.5.dist-info")
    (tmp_path / "a/rising_tank-1.5.dist-info/METADATA").write_text("Name: rising-tank\nVersion: 2\n\n")
    monkeypatch.setattr(sys, "path", [str(tmp_path / "a"), str(tmp_path / "b"), str(tmp_path / "absent"), *sys.path])
    assert versions_of(["rising_tank"]) == {"rising_tank": "2"}
    assert len([p for p in points("hil.") if p.name == "tank"]) == 1
    (tmp_path / "a/rising_tank-1.5.dist-info/entry_points.txt").unlink()
    assert not [p for p in points("hil.") if p.name == "tank"], "of the second one nothing is found"


def test_a_package_in_an_archive_is_found_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with zipfile.ZipFile(tmp_path / "tank.zip", "w") as archive:
        for file, text in INFO.items():
            archive.writestr(f"rising_tank-1.5.dist-info/{file}", text)
    monkeypatch.syspath_prepend(str(tmp_path / "tank.zip"))
    assert versions_of(["rising-tank", "numpy"]).keys() == {"rising-tank", "numpy"}
    assert [p.value for p in points("hil.") if p.name == "log"] == ["json:dumps"]


def test_a_finder_of_its_own_is_asked(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    from importlib.metadata import DistributionFinder, PathDistribution

    written(tmp_path, "rising_tank-1.5.dist-info")

    class Finder:
        def find_spec(self, *asked: object) -> None:
            return None

        def find_distributions(self, context: DistributionFinder.Context) -> list[PathDistribution]:
            return [PathDistribution(tmp_path / "rising_tank-1.5.dist-info")]

    monkeypatch.setattr(sys, "meta_path", [Finder(), *sys.meta_path])
    assert versions_of(["rising-tank"]) == {"rising-tank": "1.5"}
