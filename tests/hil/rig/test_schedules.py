"""Disturbances that overlap."""

from __future__ import annotations

from itertools import permutations
from math import fsum

from hil.api.experiment_source import load_experiment
from hil.rig.schedules import disturbance_changes


def test_pulses_that_overlap_add_up_exactly_and_in_any_order() -> None:
    pulses = [{"at": f"{at} s", "samples": samples, "value": [w]} for at, samples, w in (
        (1, 60, 1e16), (2, 60, -1e16), (2, 40, 0.1), (3, 1, 0.7),
    )]  # fmt: skip
    found = [disturbance_changes(load_experiment("dc-motor-h2", disturbance=list(order))) for order in permutations(pulses)]
    assert all(each == found[0] for each in found)
    at = {slot: value for slot, (value,) in found[0].items()}
    assert at == {20: 1e16, 40: 0.1, 60: fsum([0.1, 0.7]), 61: 0.1, 80: -1e16, 100: 0.0}
