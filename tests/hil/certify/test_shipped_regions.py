"""Regions of shipped motors, by all the moments that a verdict uses: the numbers that the guide says, and what ends them."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

import pytest

import hil
from design.verdict import Verdict
from hil.api.experiment_source import load_experiment
from hil.certify.region import RISK
from hil.compose import compose
from tests.hil.certify.test_region import ANYWHERE, ENCODER, SUPPLY

CALM: dict[str, Any] = {"reference": [], "disturbance": [], "allow_uncertified": True, "plant.driver": {"saturation_v": SUPPLY}}


def verdict_on(name: str, **changes: Any) -> Verdict:
    return _verdict_on(name, json.dumps(changes))


@cache
def _verdict_on(name: str, changes: str) -> Verdict:
    found = compose(load_experiment(name, **json.loads(changes))).verdict
    assert found is not None
    return found


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("dc-motor-h2", CALM), ("dc-motor-hinf", CALM), ("dc-motor-h2", CALM | ENCODER), ("dc-motor-hinf-friction", {}),
        ("dc-motor-hinf-supply", {}),
    ],
)
def test_the_guide_says_these_numbers(name: str, changes: dict[str, Any]) -> None:
    guide = (Path(hil.__file__).parent / "guide/designs-and-certificates.md").read_text(encoding="utf-8")
    rows = [line for line in guide.splitlines() if line.startswith(f"| `{name}`")]
    region: Any = verdict_on(name, **changes).details["region"]
    states = region["within"][0]["states"]
    said = f"{states['angle']:.3g} rad, {states['speed']:.3g} rad/s"
    if not changes:
        said = said if states["angle"] else f"none below {region['limits_times']:.3g}"
        said = f"{100 * region['pushed_share'][0]:.2g} % | {said}"
    assert any(said in row for row in rows), said


def test_a_realistic_motor_whose_supply_suffices_is_certified_until_supply_or_friction_change() -> None:
    verdict = verdict_on("dc-motor-hinf-supply")
    assert verdict.certified and verdict.kind == "stability in a region" and "ends, in the root mean square" in verdict.reason
    assert verdict.number is not None and 0.0 < verdict.number <= RISK
    for change in ({"plant.driver.saturation_v": 0.7}, {"plant.friction.static_v": 0.05}):
        undecided = verdict_on("dc-motor-hinf-supply", allow_uncertified=True, **change)
        assert undecided.kind == ANYWHERE and "not decided from where this run begins" in undecided.reason
