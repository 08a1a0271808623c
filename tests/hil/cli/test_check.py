"""`hil check`: what a plug-in has earned, or what it does not keep, in its author's words."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from tests.hil.cli.conftest import Hil
from tests.hil.measure.test_measures import OWN
from tests.strangers_package import test_strangers_package as strangers
from tests.warm_hil import hil_command

LAW = """
from dataclasses import dataclass
from typing import ClassVar

@dataclass(frozen=True)
class Coin:
    p: float = 0.3
    family: ClassVar = "age"
    max_age: ClassVar = 1
    mode_ages: ClassVar = (0, 1)

    def transition_matrix(self):
        return [[1 - self.p, self.p]] * 2

    def start(self, rng):
        return Process(rng, self.p)

class Process:
    def __init__(self, rng, p):
        self.rng, self.p = rng, p

    def draw(self):
        age = int(self.rng.random() < self.p)
        return age, age

@dataclass(frozen=True)
class Twice:
    selection: ClassVar = "constant"

    def start(self, model):
        return self

    def rows(self, k, tau, y, r):
        return (0.0,), (0.0,)

class Odd(Coin):
    @property
    def mode_ages(self):
        return {}["mode"]

    @property
    def start(self):
        return {}["start"]
"""


@pytest.mark.parametrize(
    ("words", "earned"),
    [
        (("laws", "mine:Coin", "--parameter", "p=0.5"), "Coin is a ChainLaw: loops over it can be certified"),
        (("measures", "measures:Whole"), "Whole is a Measure: its numbers stand in summary"),
        (("plants", "dc-motor"), "DCMotor is a Plant: a rig can run it"),
        (("controllers", "hinf"), "PublishedHinf is a GainTable: its loop over delay chains is certified exactly"),
        (("controllers", "designed"), "Designed is a Designer: "),
        (("measures", "tracking"), "Tracking is a BatchMeasure"),
        (("links", "can:hil:checked"), "CanLink is a Link: sessions in real time can run over it"),
    ],
)
def test_a_plug_in_says_what_it_has_earned(cli: Hil, words: tuple[str, ...], earned: str) -> None:
    Path("mine.py").write_text(LAW)
    Path("measures.py").write_text(OWN)
    status, out, err = cli("check", *words)
    assert (status, err) == (0, "") and earned in out
    if words[0] == "laws":
        assert cli("list", *words[:2])[1].startswith("mine:Coin, from mine.py\n")
        assert earned in json.loads(cli("check", *words, "--json")[1])["earned"][1]


@pytest.mark.parametrize(
    ("words", "fault"),
    [
        (("laws", "mine:Coin", "--parameter", "q"), "hil: --parameter 'q': expected path=value"),
        (("laws", "mine:Coin", "--parameter", "q=0.5"), "hil: law.q: unknown field; there are p"),
        (("laws", "mine:Coyn"), "has no 'Coyn'; it has Coin, Odd, Process, Twice"),
        (("laws", "nowhere:Coin"), "there is no nowhere.py in "),
        (("measures", "measures:Number"), "hil: check_measure: measures:Number: a run: of(view) returned 3.0, expected numbers"),
        (("measures", "measures:Leaves"), "of(view): SystemExit: 0 ("),
        (("measures", "measures:Whole", "--parameter", "a=1"), "--parameter: a measure has no keys"),
        (("links", "nope:x"), "no link is called 'nope'"),
        (("controllers", "mine:Coin"), "check_controller: "),
        (("laws", "mine:Odd"), "hil: law: 'mine:Odd': check_law: start of Odd: KeyError: 'start' ("),
        (("controllers", "mine:Twice"), "check_controller: mine:Twice: 2 rows, expected 1 for 'constant'"),
    ],
)
def test_what_a_plug_in_does_not_keep_is_one_message(cli: Hil, words: tuple[str, ...], fault: str) -> None:
    Path("mine.py").write_text(LAW)
    Path("measures.py").write_text(OWN)
    status, out, err = cli("check", *words)
    assert status == 2 and out == "" and fault in err and len(err.splitlines()) == 1 and "Traceback" not in err


site = strangers.site  # the fixture


def beside(site: Path) -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, (str(site), os.environ.get("PYTHONPATH"))))}


def test_a_link_of_a_package_is_held_to_the_contract(site: Path) -> None:
    done = hil_command("check", "links", f"datagrams:{site}", cwd=site, env=beside(site))
    assert done.returncode == 0 and "is a Link: sessions in real time can run over it" in done.stdout, done.stderr


def test_what_a_link_plug_in_opens_that_is_none_is_said_before_anything_starts(site: Path) -> None:
    (site / "no_link.py").write_text("def nothing(uri, role): return object()\ndef fails(uri, role): return {}[role]\n")
    info = site / "rising_tank-1.0.dist-info" / "entry_points.txt"
    info.write_text(strangers.ENTRY_POINTS + "nothing = no_link:nothing\nfails = no_link:fails\n")
    for scheme, fault in (("nothing", "check_link: object, what the plug-in returned, needs `uri` (the URI it was opened with)"),
                         ("fails", f"KeyError: 'rig' ({site}/no_link.py, line 2)")):  # fmt: skip
        words = ("run", "two-samples.toml", "--clock", "real", "--link", f"{scheme}:x")
        done = hil_command(*words, cwd=site, env=beside(site))
        assert done.returncode == 2 and fault in done.stderr and "Traceback" not in done.stderr, done.stderr
        assert not (site / "runs").exists()


OTHERWISE = """
from dataclasses import dataclass
from plants import LinearRun, Signal, StateSpace

@dataclass(frozen=True)
class Cart:
    damping: float = 1.0
    inputs = (Signal("force", "N"),)
    outputs = states = (Signal("speed", "m/s"),)

    def model(self):
        return StateSpace(A=[[-1.0]], B=[[1.0]], C=[[1.0]])

    def start(self, rng):
        return LinearRun(StateSpace(A=[[-self.damping]], B=[[1.0]], C=[[1.0]]), (0.0,))
"""


def test_a_plant_that_moves_otherwise_than_its_model_is_refused_before_any_run(cli: Hil) -> None:
    Path("carts.py").write_text(OTHERWISE)
    status, out, _ = cli("check", "plants", "carts:Cart")
    assert status == 0 and "the plant moves as its model says: compared over 200 slots" in " ".join(out.split())
    status, out, err = cli("check", "plants", "carts:Cart", "--parameter", "damping=1.1")
    assert status == 2 and not out and err.startswith("hil: check_plant: carts:Cart: your plant does not move as its")
