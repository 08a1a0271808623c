"""Parts of a user's own in real time: who breaks its word in the run loses the certificate, who raises is one message."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest

from hil.log.read import read_run
from tests.warm_hil import hil_command

pytestmark = pytest.mark.realtime

OWN = """
from dataclasses import dataclass
import math
import numpy as np
from plants import Signal, StateSpace


@dataclass(frozen=True)
class Tank:
    inputs = (Signal("valve", "V"),)
    outputs = (Signal("level", "m"),)
    states = (Signal("level", "m"),)

    def model(self):
        return StateSpace(A=np.array([[-1.0]]), B=np.array([[1.0]]), C=np.array([[1.0]]))

    def start(self, rng):
        return Running()


class Running:
    def __init__(self):
        self.state, self.applied, self.slots = (0.3,), (0.0,), 0

    def measure(self):
        return self.state

    def advance(self, dt_ns, u, w=()):
        if dt_ns:
            self.slots += 1
            a = -1.0
            if self.slots > 250:
                {plant}
            grown = math.exp(a * dt_ns / 1e9)
            self.state = (grown * self.state[0] + (grown - 1.0) / a * (u[0] + (w[0] if w else 0.0)),)
            self.applied = tuple(u)


@dataclass(frozen=True)
class Gains:
    selection = "constant"

    def table(self, model):
        return np.full((model.tau_max + 1, 1, 1, 1), -0.05)

    def start(self, model):
        return Answers()


class Answers:
    selection, asked = "constant", 0

    def rows(self, k, tau, y, r):
        self.asked += 1
        gain = -0.05
        if self.asked > 250:
            {controller}
        return ((gain * (y[0] - r[0]) + r[0],),)
"""
EXPERIMENT = """
name = "own"
period = "5 ms"
duration = "1.6 s"
seed = 1
[plant]
kind = "tank:Tank"
[controller]
kind = "tank:Gains"
[links]
uri = "local:"

[network]
sc.law = { kind = "constant", age = 1 }
ca.law = { kind = "constant", age = 0 }
[limits]
watchdog_slots = 300
"""


def real_time(folder: Path, link: str, experiment: str = "own.toml", **lies: str) -> tuple[int, dict[str, Any], str]:
    """Exit status, problems and standard error of a run; plant or controller of ours are other ones from slot 250 on."""
    body = OWN.replace("{plant}", lies.get("plant", "pass")).replace("{controller}", lies.get("controller", "pass"))
    (folder / "tank.py").write_text(body)
    (folder / "own.toml").write_text(EXPERIMENT)
    words = ["run", experiment, "--duration", "1.6", "--clock", "real", "--link", link, "--quiet", "--json", "-o", "a.mcap"]
    path = os.pathsep.join(filter(None, (str(folder), os.environ.get("PYTHONPATH"))))
    done = hil_command(*words, cwd=folder, env={**os.environ, "PYTHONPATH": path})
    return done.returncode, json.loads(done.stdout)["problems"], done.stderr


@pytest.mark.parametrize(("part", "lie", "link"), [
    ("plant", "a = 0.5", "local:"), ("controller", "gain = 0.4", "can:hil:{own}"),
])  # fmt: skip
def test_a_part_that_departs_in_the_run_loses_the_certificate(tmp_path: Path, part: str, lie: str, link: str) -> None:
    status, problems, errors = real_time(tmp_path, link.format(own=f"own{os.getpid()}"), **{part: lie})
    what = {"plant": "the plant left its model at slot ", "controller": "the controller left its table at slot "}[part]
    reported = problems["certificate_withdrawn"]
    assert reported.startswith(f"certificate withdrawn: {what}") and "Traceback" not in errors
    assert status == 7
    assert [e["message"] for e in read_run(tmp_path / "a.mcap").events if e["kind"] == "certificate withdrawn"] == [reported]


@pytest.mark.parametrize(("part", "raises", "link"), [
    ("plant", "raise KeyError('no such level')", "local:"), ("controller", r"raise SystemExit('\udcff')", "can:hil:{own}"),
])  # fmt: skip
def test_a_part_that_raises_in_the_run_is_one_message_and_a_whole_log(tmp_path: Path, part: str, raises: str, link: str) -> None:
    status, problems, errors = real_time(tmp_path, link.format(own=f"own{os.getpid()}"), **{part: raises})
    assert status == 1 and "Traceback" not in errors and "tank.py" not in errors
    reported = problems.pop("plug_in_failed")
    assert reported.startswith(raises[6:].partition("(")[0]) and f"{tmp_path}/tank.py, line " in reported
    assert not {"rig_lost", "controller_lost"} & problems.keys()
    run = read_run(tmp_path / "a.mcap")
    assert [e["message"] for e in run.events if e["kind"] == "plug in failed"] == [reported]
    assert len(run.arrays["/plant/state"]) > 200 and any(e["kind"] == "outcome" for e in run.events)


@pytest.mark.parametrize(("role", "where"), [("rig", "send"), ("controller", "send"), ("rig", "close")])
def test_an_own_link_that_raises_in_the_run_or_at_its_end_is_one_message_and_a_whole_log(
    tmp_path: Path, role: str, where: str
) -> None:
    (tmp_path / "torn.py").write_text(f"""
from transport.links.opening import open_link

class Torn:
    def __init__(self, role):
        self.link, self.role, self.sent = open_link("can:hil:torn{os.getpid()}", role), role, 0

    def __getattr__(self, name):
        return getattr(self.link, name)

    def __enter__(self):
        return self

    def __exit__(self, *given):
        self.link.close()
        self.raise_in("close")

    def send(self, packet):
        self.sent += 1
        self.raise_in("send")
        self.link.send(packet)

    def raise_in(self, where):
        if self.sent > 150 and self.role == "{role}" and where == "{where}":
            raise ConnectionError("the cable is torn")

def opened(uri, role):
    return Torn(role)
""")
    info = tmp_path / "torn-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: torn\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[hil.links]\ntorn = torn:opened\n")
    status, problems, errors = real_time(tmp_path, "torn:x", "dc-motor-1khz")
    assert status == 1 and "Traceback" not in errors, errors
    assert problems["plug_in_failed"].startswith(f"ConnectionError: the cable is torn ({tmp_path}/torn.py, line ")
    assert len(read_run(tmp_path / "a.mcap").arrays["/plant/state"]) > 10
