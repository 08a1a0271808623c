"""What a controller adds of its own to its table: anything that stays bounded; what grows loses the certificate."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import pytest

from design.controllers import LoopModel, Rows
from hil.api.experiment_source import load_experiment
from hil.compose import compose
from hil.rig.loop import Loop
from hil.session import simulated_session
from tests.hil.compose.lying_plugins import Plant, Rowed, Table


@dataclass(frozen=True)
class Adding(Table):
    how: str = "nothing"

    def start(self, model: LoopModel) -> Rowed:
        return AddingRows(self, model)


class AddingRows(Rowed):
    def __init__(self, table: Adding, model: LoopModel) -> None:
        super().__init__(table, model)
        self.how, self.asked, self.first, self.second, self.slow = table.how, 0, 0.0, 0.0, [0.0, 0.0]

    def rows(self, k: int, tau: int, y: Sequence[float], r: Sequence[float]) -> Rows:
        self.asked += 1
        self.first += 0.02 * (r[0] - self.first)
        self.second += 0.02 * (self.first - self.second)
        self.slow[0] += (r[0] - self.slow[0]) / 300
        self.slow[1] += (self.slow[0] - self.slow[1]) / 300
        added = ADDED[self.how](self, k, r[0]) if r[0] else 0.0
        return tuple(tuple(float(u + added) for u in row) for row in super().rows(k, tau, y, r))


ADDED: dict[str, Callable[[Any, int, float], float]] = {
    "nothing": lambda run, k, r: 0.0,
    "a share of the reference": lambda run, k, r: 0.3 * r,
    "a filter": lambda run, k, r: run.first,
    "a filter of second order": lambda run, k, r: run.second,
    "a slow filter of second order": lambda run, k, r: run.slow[1],
    "a sine": lambda run, k, r: 0.2 * math.sin(run.asked / 20),
    "a slow sine": lambda run, k, r: math.sin(run.asked / 300),
    "one random number after the other": lambda run, k, r: 0.1 * math.sin(run.asked**2),
    "a late step": lambda run, k, r: 0.3 if run.asked > 850 else 0.0,
    "a ramp in calls": lambda run, k, r: 1e-3 * run.asked,
    "a late ramp": lambda run, k, r: 1e-3 * max(0, run.asked - 400),
    "an exponential": lambda run, k, r: 1e-6 * 1.03**run.asked,
    "a ramp of either sign": lambda run, k, r: 1e-3 * run.asked * (-1) ** run.asked,
    "a sine that grows": lambda run, k, r: 1e-3 * run.asked * math.sin(run.asked / 7),
    "a ramp in slots": lambda run, k, r: 1e-3 * k,
    "a root of the slots": lambda run, k, r: 1e-2 * k**0.5,
}
GROWING = list(ADDED)[9:14]
BOUNDED = list(ADDED)[:9]


def loop_of(how: str) -> Loop:
    reported: dict[str, Any] = {"plant": Plant(), "controller": Adding(how=how), "limits.state": {}, "limits.input": [1e6]}
    return compose(load_experiment("dc-motor-h2", allow_uncertified=True, duration="50 s", **reported))


@pytest.mark.parametrize("how", GROWING)
def test_what_grows_in_the_run_loses_the_certificate(how: str) -> None:
    loop = loop_of(how)
    assert loop.verdict is not None and loop.verdict.certified
    assert any("adds of its own" in each and "bounded" in each for each in loop.verdict.assumptions)
    session = simulated_session(loop, 3)
    reported = session.summary["problems"]["certificate_withdrawn"]
    assert session.status == 7 and "what it adds on samples of zero, which grows to" in reported, reported
    assert session.summary["certificate"]["state"] == "undecided"


@pytest.mark.parametrize("how", BOUNDED)
def test_what_stays_bounded_keeps_it(how: str) -> None:
    session = simulated_session(loop_of(how), 3)
    assert session.status == 0 and session.summary["certificate"]["state"] == "certified", session.summary["problems"]


@pytest.mark.parametrize("how", ["a ramp in slots", "a root of the slots"])
def test_what_grows_with_the_number_of_the_slot_is_seen_at_the_door(how: str) -> None:
    verdict = loop_of(how).verdict
    assert verdict is not None and verdict.state == "undecided"
    assert "what the controller adds of its own grows with time" in verdict.reason
