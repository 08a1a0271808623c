"""What an encoder makes of an angle."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plants.parts.actuators import Encoder

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


@pytest.mark.parametrize("step", [-1.0, math.nan, math.inf])
def test_a_step_that_is_none_is_refused(step):
    with pytest.raises(ValueError, match=r"^step_rad: "):
        Encoder(step_rad=step)
