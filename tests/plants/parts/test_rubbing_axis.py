"""Friction: sticks exactly, slips exactly, never chatters, never gives energy; many axes move as one alone, to the last bit."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from plants.parts.actuators import Friction
from plants.parts.exponential import log1p, log1p_many, phi, phi_many
from plants.parts.rubbing_axis import RubbingAxes, RubbingAxis

GAIN, POLE = 172.38, 3.5287
SIMPLE = Friction(coulomb_v=0.0017, static_v=0.0026)
STRIBECK = Friction(coulomb_v=0.0017, static_v=0.0026, stribeck_speed_rad_s=0.2, viscous_v_s_per_rad=0.001)
ODD = Friction(coulomb_v=0.0, static_v=0.5, stribeck_speed_rad_s=1.0)

frictions = st.sampled_from([SIMPLE, STRIBECK, ODD, Friction(coulomb_v=0.01)])
speeds = st.floats(-5, 5)
drives = st.floats(-0.06, 0.06)
spans = st.floats(1e-9, 2.0)


def axis(friction):
    return RubbingAxis(GAIN, POLE, friction)


def kinetic(speed):
    return 0.5 * speed * speed / GAIN


@settings(deadline=None)
@given(frictions, st.floats(-1, 1), spans, st.floats(-100, 100))
def test_a_drive_inside_the_stiction_band_moves_nothing(friction, share, span, angle):
    assert axis(friction).move(angle, 0.0, share * friction.breakaway_v, span) == (angle, 0.0)


@settings(deadline=None)
@given(frictions, st.floats(1.0001, 10), spans)
def test_a_drive_outside_the_stiction_band_moves_in_its_direction(friction, factor, span):
    angle, speed = axis(friction).move(0.0, 0.0, factor * friction.breakaway_v, span)
    assert angle > 0.0
    assert speed > 0.0
    assert axis(friction).move(0.0, 0.0, -factor * friction.breakaway_v, span) == (-angle, -speed)


@settings(deadline=None)
@given(frictions, speeds, drives, spans)
def test_friction_never_injects_energy(friction, speed, drive, span):
    """Kinetic energy gained is at most the work of the drive, in volts times rad."""
    travel, after = axis(friction).move(0.0, speed, drive, span)
    assert kinetic(after) - kinetic(speed) <= drive * travel + 1e-12


@settings(deadline=None)
@given(frictions, speeds, spans)
def test_without_a_drive_the_speed_only_falls_and_keeps_its_direction(friction, speed, span):
    _, after = axis(friction).move(0.0, speed, 0.0, span)
    assert abs(after) <= abs(speed)
    assert after * speed >= 0.0


@settings(deadline=None)
@given(frictions, speeds, drives, spans, spans)
def test_two_moves_are_one_of_their_sum(friction, speed, drive, a, b):
    # where drive and friction balance at an unstable point, the smallest rounding grows: not asked for here
    assume(friction is not ODD)
    once = axis(friction).move(0.0, speed, drive, a + b)
    twice = axis(friction).move(*axis(friction).move(0.0, speed, drive, a), drive, b)
    assert twice == pytest.approx(once, rel=1e-9, abs=1e-9)


def test_stopping_has_its_closed_form():
    """v' = -p v - g Fc from v0: rest after ln(1 + p v0/(g Fc))/p, at (v0 - g Fc t)/p."""
    v0, deceleration = 2.0, GAIN * SIMPLE.coulomb_v
    rest = math.log1p(POLE * v0 / deceleration) / POLE
    angle, speed = axis(SIMPLE).move(0.0, v0, 0.0, rest * (1 - 1e-9))
    assert 0.0 < speed < 1e-8
    angle, speed = axis(SIMPLE).move(0.0, v0, 0.0, rest + 10.0)
    assert speed == 0.0
    assert angle == pytest.approx((v0 - deceleration * rest) / POLE, rel=1e-13)


def test_one_rounding_before_it_stops_it_does_not_turn_back():
    """There what is computed of the speed is often below zero."""
    for v0 in np.linspace(0.01, 1.0, 100).tolist():
        rest = math.log1p(POLE * v0 / (GAIN * SIMPLE.coulomb_v)) / POLE
        for span in (rest, math.nextafter(rest, 0.0), rest * (1 - 4e-16)):
            assert axis(SIMPLE).move(0.0, v0, 0.0, span)[1] >= 0.0


def test_a_reversal_passes_zero_once():
    """Sampled a thousand times through the reversal, the speed changes its sign once: no chattering."""
    rubbing, angle, speed = axis(STRIBECK), 0.0, 1.0
    signs = []
    for _ in range(1000):
        angle, speed = rubbing.move(angle, speed, -0.01, 0.001)
        signs.append(math.copysign(1.0, speed))
    assert sum(a != b for a, b in pairwise(signs)) == 1
    assert signs[-1] == -1.0


def test_at_rest_every_further_sample_is_the_same_to_the_last_bit():
    rubbing = axis(STRIBECK)
    angle, speed = rubbing.move(0.1, 1.0, 0.0, 10.0)
    assert speed == 0.0
    for _ in range(100):
        assert rubbing.move(angle, speed, 0.0025, 0.05) == (angle, 0.0)


def chords(friction, speed):
    corners, values = friction.curve()
    return np.interp(abs(speed), corners, values)


def integrated(friction, curve, speed, drive, span):
    """The same motion by an adaptive Runge-Kutta method, as long as it slips in one direction."""
    sign = math.copysign(1.0, speed)

    def rhs(t, x):
        rub = sign * curve(x[1]) + friction.viscous_v_s_per_rad * x[1]
        return [x[1], -POLE * x[1] + GAIN * (drive - rub)]

    return solve_ivp(rhs, (0.0, span), [0.0, speed], rtol=1e-11, atol=1e-13, max_step=span / 200).y[:, -1]


@pytest.mark.parametrize(("speed", "drive", "span"), [(1.0, 0.0, 0.3), (1e-3, 0.004, 0.5), (-0.7, -0.02, 0.4)])
def test_slipping_through_the_stribeck_curve_agrees_with_an_integrator(speed, drive, span):
    got = axis(STRIBECK).move(0.0, speed, drive, span)
    assert got == pytest.approx(integrated(STRIBECK, lambda v: chords(STRIBECK, v), speed, drive, span), abs=1e-8)

    def smooth(v):
        return STRIBECK.coulomb_v + 0.0009 * math.exp(-((v / 0.2) ** 2))

    assert got == pytest.approx(integrated(STRIBECK, smooth, speed, drive, span), abs=2e-4)


def test_the_chords_keep_to_the_stribeck_curve():
    v = np.linspace(0.0, 1.0, 5001)
    smooth = STRIBECK.coulomb_v + 0.0009 * np.exp(-((v / 0.2) ** 2))
    assert np.abs(chords(STRIBECK, v) - smooth).max() <= 0.004 * 0.0009


@pytest.mark.parametrize("drive", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("speed", [0.0, 1.0, math.nan])
def test_a_drive_that_is_no_number_ends_all_the_same(drive, speed):
    axis(STRIBECK).move(0.0, speed, drive, 1.0)


def test_static_friction_is_coulomb_friction_unless_said():
    assert Friction(coulomb_v=0.3).breakaway_v == 0.3
    assert not Friction(viscous_v_s_per_rad=0.3).dry


RUNS = 1500
FRICTIONS = {
    "coulomb and static": Friction(coulomb_v=0.0017, static_v=0.0042),
    "stribeck": Friction(coulomb_v=0.0017, static_v=0.0042, stribeck_speed_rad_s=0.3),
    "static only, steep": Friction(static_v=0.3, stribeck_speed_rad_s=0.001),
    "viscous too": Friction(coulomb_v=0.002, viscous_v_s_per_rad=0.01),
}


@pytest.mark.parametrize("name", FRICTIONS)
def test_many_axes_move_as_one_alone_does(name):
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
        found = many.hold(angle, speed, drive, dt_ns)
        moves = [one.move(*three, dt_ns / 1e9) for three in zip(angle.tolist(), speed.tolist(), drive.tolist(), strict=True)]
        for a, b in zip(found, zip(*moves, strict=True), strict=True):
            np.testing.assert_array_equal(a, np.array(b))
            np.testing.assert_array_equal(np.signbit(a), np.signbit(b))
    assert 0 < (found[1] == 0.0).sum() < RUNS  # both kinds: at rest and moving


def test_what_is_beyond_all_numbers_is_not_a_number_and_spoils_no_other():
    many = RubbingAxes(GAIN, POLE, FRICTIONS["stribeck"])
    angles, speeds = many.hold(np.zeros(3), np.array([np.nan, 1e300, 0.5]), np.array([0.0, np.inf, 0.01]), 50_000_000)
    assert not np.isfinite(speeds[:2]).all() and np.isfinite([angles[2], speeds[2]]).all()


def test_functions_of_many_have_the_bits_of_one():
    rng = np.random.default_rng(1)
    x = np.concatenate(([0.0, 0.5, -0.5], rng.standard_normal(400) * 10.0 ** rng.integers(-9, 3, 400)))
    for k in (0, 1):
        np.testing.assert_array_equal(phi_many(x)[k], [phi(v)[k] for v in x.tolist()])
    z = np.concatenate(([0.0, -0.3, 0.42, -0.9999999], np.abs(x) * 1e3, -rng.random(200)))
    np.testing.assert_array_equal(log1p_many(z), [log1p(v) for v in z.tolist()])
    assert np.isnan(phi_many(np.array([1e300, np.nan]))[0]).all()
