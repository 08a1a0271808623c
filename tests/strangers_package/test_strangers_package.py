"""A distribution of its own adds a plant with modes, a chain law, a controller of two samples, a measure and a link."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
TANK = HERE.parent / "hil" / "certify" / "two_speed_tank.py"

ENTRY_POINTS = """
[hil.plants]
rising-tank = two_speed_tank:TwoSpeedTank
[hil.laws]
sticky = rising_tank:Sticky
[hil.controllers]
difference = rising_tank:Difference
[hil.measures]
wear = rising_tank:Wear
[hil.links]
datagrams = rising_tank:open_datagrams
"""

MODES = """
name = "tank"
period = "20 ms"
duration = "2 s"
[plant]
kind = "rising-tank"
[controller]
kind = "robust-scheduled"
gain_bound = 4.0
decay = 0.5
[links]
uri = "datagrams:FOLDER"

[network]
sc.law = { kind = "constant", age = 0 }
ca.law = { kind = "constant", age = 0 }
[report]
measures = ["wear"]
"""

SAMPLES = """
name = "two-samples"
period = "50 ms"
duration = "5 s"
[plant]
kind = "dc-motor"
[controller]
kind = "difference"
[[reference]]
at = "0.5 s"
value = [1.0]
[links]
uri = "datagrams:FOLDER"

[network]
sc.law = { kind = "sticky" }
ca.law = { kind = "sticky", change = 0.5 }
[report]
measures = ["tracking", "wear"]
"""

CHECKS = """
import json, sys, tempfile
import hil
from hil.compose import compose
from hil.plugins.checks import check_controller, check_law
from hil.measure.check import check_measure
from hil.measure.view import view_of
from plants import check_plant
from transport import check_link, open_link
from rising_tank import Difference, Sticky, Wear
from two_speed_tank import TwoSpeedTank

said = check_plant(TwoSpeedTank()) + check_law(Sticky())
loop = compose(hil.load_experiment(sys.argv[1]))
said += check_controller(Difference(), loop.model)
check_measure(Wear(), view_of(hil.run(sys.argv[1]).run))
uri = "datagrams:" + tempfile.mkdtemp()
check_link(lambda: (open_link(uri, "rig"), open_link(uri, "controller")))
print(json.dumps(said))
"""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of packages, with the distribution as an installer leaves it."""
    folder = tmp_path_factory.mktemp("site")
    for module in (HERE / "rising_tank.py", TANK):
        shutil.copy(module, folder)
    info = folder / "rising_tank-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: rising-tank\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(ENTRY_POINTS)
    for name, text in (("tank", MODES), ("two-samples", SAMPLES)):
        (folder / f"{name}.toml").write_text(text.replace("FOLDER", str(folder)))
    return folder


def python(site: Path, *words: str) -> subprocess.CompletedProcess[str]:
    folders = os.pathsep.join(filter(None, (str(site), os.environ.get("PYTHONPATH"))))  # a mutated checkout stays in front
    return subprocess.run(
        [sys.executable, *words], cwd=site, env={**os.environ, "PYTHONPATH": folders},
        capture_output=True, text=True, timeout=200, check=False,
    )  # fmt: skip


def summary(site: Path, experiment: str, *words: str) -> tuple[int, dict[str, object]]:
    done = python(site, "-m", "hil", "run", f"{experiment}.toml", "--json", *words)
    assert done.stdout, done.stderr
    return done.returncode, json.loads(done.stdout)


def test_every_shipped_check_passes_and_says_what_the_class_earns(site: Path) -> None:
    done = python(site, "-c", CHECKS, "two-samples.toml")
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    for sentence in ("TwoSpeedTank is a JumpPlant", "Sticky is a ChainLaw: loops over it can be certified",
                     "Difference is a GainTable: its loop over delay chains is certified exactly",
                     "Difference takes SeveralSamples: 2 in one sensor packet"):  # fmt: skip
        assert any(sentence in line for line in said), sentence


def test_the_loop_of_its_plant_is_certified_and_runs(site: Path) -> None:
    status, reported = summary(site, "tank")
    assert status == 0 and reported["certificate"]["state"] == "certified"  # type: ignore[index]
    assert reported["metrics"]["wear"] > 0  # type: ignore[index]


def test_the_loop_of_its_law_and_controller_is_certified_runs_and_is_refused_where_it_diverges(site: Path) -> None:
    status, reported = summary(site, "two-samples")
    assert status == 0 and reported["certificate"]["state"] == "certified"  # type: ignore[index]
    assert reported["metrics"]["wear"] > 0  # type: ignore[index]
    done = python(site, "-m", "hil", "run", "two-samples.toml", "--set", "controller.gain=-20")
    assert done.returncode == 2 and "no certificate of mean-square stability, refused" in done.stderr


@pytest.mark.realtime
def test_it_runs_in_real_time_over_its_own_link(site: Path) -> None:
    done = python(site, "-m", "hil", "run", "two-samples.toml", "--clock", "real", "--duration", "1", "--json",
                  "--set", "limits.watchdog_slots=1000")  # fmt: skip
    assert done.returncode == 0, done.stderr
    timing = json.loads(done.stdout)["timing"]
    assert timing["late"] < 20 and timing["round_trip_us"]["p50"] > 0  # some slot was answered, however busy the machine
