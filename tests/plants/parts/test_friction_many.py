"""Many axes with dry friction at once move as one alone, to the last bit."""

from __future__ import annotations

import numpy as np
import pytest

from plants.parts.actuators import Friction
from plants.parts.exponential import log1p, log1p_many, phi, phi_many
from plants.parts.motor_batch import RubbingAxes
from plants.parts.rubbing_axis import RubbingAxis

GAIN, POLE, RUNS = 172.38, 3.5287, 1500
FRICTIONS = {
    "coulomb and static": Friction(coulomb_v=0.0017, static_v=0.0042),
    "stribeck": Friction(coulomb_v=0.0017, static_v=0.0042, stribeck_speed_rad_s=0.3),
    "static only, steep": Friction(static_v=0.3, stribeck_speed_rad_s=0.001),
    "viscous too": Friction(coulomb_v=0.002, viscous_v_s_per_rad=0.01),
}


@pytest.mark.parametrize("name", FRICTIONS)
def test_many_axes_move_as_one_alone_does(name: str) -> None:
    """From rest, at corners of the curve and between, for drives inside the stiction band, at its edge and beyond."""
    friction = FRICTIONS[name]
    one, many = RubbingAxis(GAIN, POLE, friction), RubbingAxes(GAIN, POLE, friction)
    rng = np.random.default_rng(0)
    angle = rng.standard_normal(RUNS)
    speed = rng.choice([0.0, 1e-3, 0.1, 1.0, 3.0], RUNS) * rng.standard_normal(RUNS)
    at_corner = rng.random(RUNS) < 0.2
    speed[at_corner] = rng.choice([-1.0, 1.0], at_corner.sum()) * rng.choice(one.corners, at_corner.sum())
    edge = rng.choice([-1.0, 1.0], RUNS) * rng.choice([friction.breakaway_v, friction.coulomb_v], RUNS)
    drive = np.where(rng.random(RUNS) < 0.3, edge, rng.choice([0.0, 0.002, 0.05, 1.0], RUNS) * rng.standard_normal(RUNS))
    for dt_ns in (0, 1_000_000, 50_000_000, 2_000_000_000):
        found = many.move(angle, speed, drive, dt_ns)
        moves = [one.move(*three, dt_ns / 1e9) for three in zip(angle.tolist(), speed.tolist(), drive.tolist(), strict=True)]
        for a, b in zip(found, zip(*moves, strict=True), strict=True):
            np.testing.assert_array_equal(a, np.array(b))
            np.testing.assert_array_equal(np.signbit(a), np.signbit(b))
    assert 0 < (found[1] == 0.0).sum() < RUNS  # both kinds: at rest and moving


def test_what_is_beyond_all_numbers_is_not_a_number_and_spoils_no_other() -> None:
    many = RubbingAxes(GAIN, POLE, FRICTIONS["stribeck"])
    angles, speeds = many.move(np.zeros(3), np.array([np.nan, 1e300, 0.5]), np.array([0.0, np.inf, 0.01]), 50_000_000)
    assert not np.isfinite(speeds[:2]).all() and np.isfinite([angles[2], speeds[2]]).all()


def test_functions_of_many_have_the_bits_of_one() -> None:
    rng = np.random.default_rng(1)
    x = np.concatenate(([0.0, 0.5, -0.5], rng.standard_normal(400) * 10.0 ** rng.integers(-9, 3, 400)))
    for k in (0, 1):
        np.testing.assert_array_equal(phi_many(x)[k], [phi(v)[k] for v in x.tolist()])
    z = np.concatenate(([0.0, -0.3, 0.42, -0.9999999], np.abs(x) * 1e3, -rng.random(200)))
    np.testing.assert_array_equal(log1p_many(z), [log1p(v) for v in z.tolist()])
    assert np.isnan(phi_many(np.array([1e300, np.nan]))[0]).all()
