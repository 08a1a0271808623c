"""Chapter 7's rows on a controller that estimates d_k by the state of its chain."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize

from design.tracking.synthesis import TrackingProblem
from hil.thesis.chapter7_delays import ESTIMATED, by_estimate, estimated_delay, packet_by_packet
from hil.thesis.chapter7_designs import PLANTS
from hil.thesis.chapter7_models import NETWORK, motor
from hil.thesis.statements import judge
from tests.hil.thesis.judging import assert_every_number_decides


def test_the_mean_over_the_filter_is_the_gain_of_the_delay_before() -> None:
    gains = np.random.default_rng(0).standard_normal((3, 2, 1, 1))
    filtered = np.einsum("rs,tsmp->trmp", NETWORK[1], by_estimate(gains))
    np.testing.assert_allclose(filtered, gains, rtol=1e-12)


def test_rows_on_the_estimate_hold_and_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    """By one start of each descent, of those by differences by two steps, and by 1000 runs packet by packet."""
    monkeypatch.setattr("scipy.optimize.minimize", partial(minimize, options={"maxiter": 2}))
    monkeypatch.setattr("hil.thesis.chapter7_delays.packet_by_packet", partial(packet_by_packet, runs=1000))
    monkeypatch.setattr("hil.thesis.chapter7_designs.TrackingProblem", partial(TrackingProblem, starts=1))
    steps: list[tuple[int, int]] = []
    values: dict[str, Any] = dict(estimated_delay(lambda text, done=0, total=0, /: steps.append((done, total))))
    assert steps == [(n, len(PLANTS) + 1) for n in range(len(PLANTS) + 1)]
    rows = judge(ESTIMATED, values)
    assert [row.verdict for row in rows] == ["reproduced"] * 4
    assert_every_number_decides(rows)


def test_packets_without_feedback_cost_what_the_plant_alone_does() -> None:
    """No gains: |z|^2 is that of the plant's own motion, the same in every run."""
    plant, modes = motor(), (np.zeros(1, dtype=int), np.zeros(1, dtype=int), np.ones(1))
    square, error = packet_by_packet(plant, np.zeros((3, 2, 1, 1)), *modes, runs=5)
    x, expected = plant.B[:, 0], 0.0
    for _ in range(300):
        expected += float((plant.C @ x) @ (plant.C @ x))
        x = plant.A @ x
    assert error < 1e-9 and np.isclose(square, expected, rtol=1e-12)
