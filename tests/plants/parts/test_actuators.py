"""What a driver makes of a command, and an encoder of an angle."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plants.parts.actuators import Driver, Encoder

REAL = Driver(saturation_v=0.058, pwm_step_v=0.0005, dead_zone_v=0.0033)
volts = st.floats(-1, 1)


@settings(deadline=None)
@given(volts)
def test_a_driver_is_odd_and_never_exceeds_the_supply(u):
    v = REAL.drive(u)
    assert REAL.drive(-u) == -v
    assert abs(v) <= 0.058 - 0.0033


@settings(deadline=None)
@given(volts, volts)
def test_a_larger_command_never_gives_less(a, b):
    low, high = sorted((a, b))
    assert REAL.drive(low) <= REAL.drive(high)


@settings(deadline=None)
@given(volts)
def test_an_ideal_driver_passes_the_command(u):
    assert Driver().ideal
    assert Driver().drive(u) == u


@settings(deadline=None)
@given(volts)
def test_pwm_gives_whole_counts(u):
    v = Driver(pwm_step_v=0.01).drive(u)
    assert abs(v - u) <= 0.005 + 1e-12
    assert v / 0.01 == pytest.approx(round(v / 0.01), abs=1e-9)


def test_pwm_never_rounds_above_the_supply():
    assert Driver(saturation_v=0.0058, pwm_step_v=0.001).drive(1.0) == pytest.approx(0.005)


def test_the_dead_zone_swallows_small_commands_and_shifts_large_ones():
    driver = Driver(dead_zone_v=0.25)
    assert [driver.drive(u) for u in (-1.0, -0.25, 0.1, 0.25, 0.5)] == [-0.75, 0.0, 0.0, 0.0, 0.25]
    assert math.copysign(1.0, driver.drive(-0.1)) == 1.0


@pytest.mark.parametrize("u", [math.inf, -math.inf])
def test_an_infinite_command_saturates(u):
    assert abs(REAL.drive(u)) == pytest.approx(0.058 - 0.0033)


@pytest.mark.parametrize("driver", [REAL, Driver(), Driver(pwm_step_v=0.1), Driver(dead_zone_v=0.1)])
def test_a_command_that_is_no_number_stays_visible(driver):
    assert math.isnan(driver.drive(math.nan))


STEP = 0.0038


@settings(deadline=None)
@given(st.floats(-1e4, 1e4))
def test_a_reading_is_the_nearest_whole_count(angle):
    reading = Encoder(step_rad=STEP).read(angle)
    assert abs(reading - angle) <= STEP / 2 * (1 + 1e-6)
    assert reading / STEP == pytest.approx(round(reading / STEP), abs=1e-6)


@settings(deadline=None)
@given(st.floats(allow_nan=False))
def test_without_a_step_the_reading_is_the_angle(angle):
    assert Encoder().read(angle) == angle


@pytest.mark.parametrize("angle", [math.nan, math.inf, -math.inf])
def test_a_state_that_is_lost_stays_visible(angle):
    assert repr(Encoder(step_rad=STEP).read(angle)) == repr(angle)
