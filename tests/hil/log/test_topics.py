"""The registry of topics: one new file is a new topic everywhere, and breaks no older log."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from msgspec.structs import replace

import hil
from hil.errors import HilError
from hil.log import SLOT, Logged, MissingTopic, Topic
from hil.log.records import Schema
from hil.log.topics import TOPICS, channels, panels
from tests.hil.log.recording import Signal

ROOT = Path(__file__).parents[3]
POWER = """
from hil.log import SLOT, Curve, Topic, f64

TOPICS = (
    Topic(
        name="/plant/power", schema="PlantPower", filled_by="rig, every slot", since="9.9.0",
        fields=lambda logged: (f64("power", "W", "input times output"), SLOT),
        values=lambda slot: (slot.u[0] * slot.y[0], slot.k),
        curves=lambda names, outputs: [Curve(panel="power", field="power")],
    ),
)
"""
ASK = """
import json, sys
from pathlib import Path
import hil
from hil.log.read.export import export
from hil.log import MissingTopic
from hil.measure.summary import summarise
from hil.measure.view import view_of
from hil.pages.viewers import foxglove
from hil.pages.run_page import render_report

old, folder = hil.read_run(sys.argv[1]), Path(sys.argv[2])
try:
    lacks = str(old.arrays["/plant/power"])
except MissingTopic as error:
    lacks = str(error)
experiment = hil.load_experiment("dc-motor-hinf", duration=1)
session = hil.run(experiment, log=folder / "new.mcap")
new = hil.read_run(folder / "new.mcap")
power, applied, measured = (new.arrays[t] for t in ("/plant/power", "/actuator/applied", "/plant/measurement"))
export(new, folder / "new.csv")
view = view_of(new)
print(json.dumps({
    "lacks": lacks, "old": hil.verify(sys.argv[1]).difference, "new": hil.verify(folder / "new.mcap").difference,
    "right": bool((power["power"] == applied["voltage"] * measured["angle"]).all() and len(power) == 20),
    "old page": "<h" in render_report(view_of(old)),
    "page": ">Power<" in render_report(view),
    "layout": "/plant/power.power" in foxglove(new.schemas), "files": [p.name for p in sorted(folder.glob("*power*"))],
}))
"""


def test_a_new_topic_is_one_file_and_breaks_no_older_log(tmp_path: Path) -> None:
    """A copy of the packages gets one more file; the log that it reads was written without."""
    hil.run(hil.load_experiment("dc-motor-hinf", duration=1), log=tmp_path / "old.mcap")
    for package in ("hil", "plants", "transport", "design"):
        shutil.copytree(ROOT / package, tmp_path / "copy" / package, ignore=shutil.ignore_patterns("__pycache__", "*.so"))
    (tmp_path / "copy/hil/log/topics/power.py").write_text(POWER)
    done = subprocess.run(
        [sys.executable, "-P", "-c", ASK, str(tmp_path / "old.mcap"), str(tmp_path)],
        capture_output=True, text=True, env=os.environ | {"PYTHONPATH": str(tmp_path / "copy")},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found.pop("lacks").startswith(
        "topic /plant/power: this log lacks it; it is written by the rig, every slot, since hilrig 9.9.0; it has /plant/state,"
    )
    assert found.pop("files") == ["new.plant_power.csv"]
    assert found == {"old": None, "new": None, "right": True, "old page": True, "page": True, "layout": True}


def test_a_topic_says_which_sessions_have_it(monkeypatch: pytest.MonkeyPatch) -> None:
    topic = Topic(
        name="/bus/load", schema="BusLoad", fields=lambda _: (SLOT,), filled_by="rig", since="9.9.0",
        logged=lambda logged: logged.on_can,
    )  # fmt: skip
    monkeypatch.setitem(TOPICS, topic.name, topic)
    assert topic.name in channels(Logged(on_can=True)) and topic.name not in channels(Logged())


def test_a_reader_says_what_a_log_lacks(tmp_path: Path) -> None:
    run = hil.run(hil.load_experiment("dc-motor-hinf", duration=0.5), log=tmp_path / "x.mcap").run
    read = hil.read_run(tmp_path / "x.mcap")
    for each in (run, read):
        del each.arrays["/reference"]
        for ask in (lambda run=each: run.needs("/reference"), lambda run=each: run.arrays["/reference"]):
            with pytest.raises(MissingTopic, match="topic /reference: this log lacks it; it is written by the rig") as why:
                ask()
            assert isinstance(why.value, HilError) and isinstance(why.value, KeyError)


BARE = Logged(
    states=(Signal("angle", "rad"), Signal("speed", "rad/s")), inputs=(Signal("voltage", "V"), Signal("W tension", "N")),
    outputs=(Signal("angle", "rad"), Signal("mode", "1")), n_rows=2,
)  # fmt: skip
WHOLE = replace(BARE, numbered=True, passivity=True, on_can=True, bus=True, n_rows=0)


def described(logged: Logged) -> list[str]:
    """What a session logs: every topic with its number, fields and units, and how it is plotted."""
    found, table = [], channels(logged)
    for name, topic in TOPICS.items():
        if name in table or not topic.logged(WHOLE):
            number = table[name].id if name in table else "-"
            found.append(f"{number} {name} {topic.schema_name(logged)}: {topic.filled_by}, since {topic.since}")
            found += [f"    {field.line}" for field in topic.fields(logged)]
            found += [f"    {what}" for what in ("frames", "paged") if getattr(topic, what)]
    schemas = {name: channel.schema for name, channel in table.items()}
    for title, curves in panels(schemas).items():
        found.append(f"{title}: " + ", ".join(f"{name} {curve.field}" for name, curve in curves))
    return found


def test_every_topic_is_as_it_is_printed() -> None:
    """`print(*described(BARE), *described(WHOLE), sep="\\n")` prints the file: who changes a topic changes it too."""
    assert [*described(BARE), *described(WHOLE)] == (ROOT / "tests/data/topics.txt").read_text().splitlines()
    schemas = {name: c.schema for name, c in channels(BARE).items()}
    assert [*panels(schemas, ["/timing/slot"])] == ["timing, us"]
    applied = schemas["/actuator/applied"]
    lacks = Schema(name=applied.name, fields=tuple(f for f in applied.fields if not f.name.startswith("w_")))
    assert all(curve.field in {f.name for f in lacks.fields} for curves in panels({"/actuator/applied": lacks}).values()
               for _, curve in curves), "a log may lack the disturbances"  # fmt: skip
