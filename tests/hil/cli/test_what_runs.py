"""The guide's table of what runs the files that an experiment names: each of its commands, over a module that leaves a mark."""

from __future__ import annotations

from pathlib import Path

import pytest

from hil.experiment import shipped
from tests.hil.cli.conftest import Hil

EVIL = "from pathlib import Path\nPath({mark!r}).touch()\n"
GUIDE = Path(__file__).parents[3] / "hil/guide/own-plant-law-controller.md"

RUNS = {  # command: whether it runs what e.toml names
    "run e.toml": True,
    "live e.toml --script end.txt": True,
    "rig e.toml": True,
    "controller e.toml": True,
    "sweep e.toml --runs 1": True,
    "compare e.toml dc-motor-hinf --runs 2": True,
    "design e.toml": True,
    "can analyse e.toml": True,
    "new controller c --language python --for e.toml": True,
    "check controllers h2 --in e.toml": True,
    "laws e.toml": True,
    "dbc e.toml": True,
    "bench timing --experiment e.toml --duration 1s": True,
    "solve e.toml": True,
    "layout foxglove e.toml -o l.json": True,
    "list plants evil:Plant": True,
    "check plants evil:Plant": True,
    "sweep dc-motor-hinf --runs 1 --duration 1s --metric evil:number": True,
    "report a.mcap": False,
    "replay a.mcap": False,
    "export a.mcap -o a.npz": False,
    "layout foxglove a.mcap": False,
    "recover a.mcap -o b.mcap": False,
    "replay a.mcap --folder .": True,
    "show e.toml": False,
    "list": False,
    "schema": False,
    "guide": False,
}


@pytest.mark.parametrize(("line", "runs"), RUNS.items())
def test_a_command_runs_what_the_guide_says_and_no_more(cli: Hil, line: str, runs: bool) -> None:
    mark, motor = Path("ran").resolve(), shipped()["dc-motor-hinf"].read_text()
    here = Path("e.toml")
    here.write_text(motor)
    if "a.mcap" in line:
        Path("evil.py").write_text(LAW)
        assert cli("run", "e.toml", "--duration", "1", "-o", "a.mcap", "--set", 'network.sc.law={kind="evil:Law"}')[0] == 0
    Path("evil.py").write_text((LAW if "a.mcap" in line else "") + EVIL.format(mark=str(mark)) + "# another text\n")
    Path("end.txt").write_text('{"slot": 1, "field": "end", "value": null}')
    here.write_text(motor.replace('kind = "dc-motor"', 'kind = "evil:Plant"\nmass = 1.0'))
    cli(*line.split())
    assert mark.exists() == runs


def test_each_command_of_the_table_is_tried() -> None:
    table = GUIDE.read_text().partition("## What runs the files that an experiment names")[2].partition("An FMU runs")[0]
    for word in ("run", "live", "rig", "controller", "sweep", "compare", "design", "can analyse", "new", "laws", "dbc", "solve",
                 "bench timing", "check", "list", "report", "replay",
                 "export", "layout", "recover", "show", "schema", "guide"):  # fmt: skip
        assert f"`{word}" in table, word
        assert any(line.startswith(word) for line in RUNS), word


LAW = """
from dataclasses import dataclass
from typing import ClassVar

@dataclass(frozen=True)
class Law:
    family: ClassVar = "age"
    max_age: ClassVar = 0
    mode_ages: ClassVar = (0,)

    def transition_matrix(self):
        return [[1.0]]

    def start(self, rng):
        return self

    def draw(self):
        return 0, 0

"""
