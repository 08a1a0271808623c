"""Dry friction that a fit takes for damping: how often it is seen, and how seldom where there is none."""

import math

import numpy as np
import pytest
from scipy.stats import binom

from design.identification import Record, dry_friction, forced, held, square_wave
from design.identification.output_error import identify_axis
from tests.design.identification.axis_runs import square_records

GAIN, POLE, PERIOD_S, SLOTS, WITHIN = 8.0, 3.0, 0.02, 400, 20
T = PERIOD_S * np.arange(SLOTS)
CHIRP = np.sin(2.0 * np.pi * (0.2 * T + 0.3 * T * T / T[-1]))
SQUARE = square_wave(SLOTS, PERIOD_S, 0.5, 1.0)


def braked(u, friction):
    """The output of the axis with dry friction, in twenty steps a sample: it sticks where the input does not overcome it."""
    step, y, v, found = held(POLE, PERIOD_S / WITHIN), 0.0, 0.0, []
    for push in u:
        found.append(y)
        for _ in range(WITHIN):
            against = friction * np.sign(v) if v else np.clip(push, -friction, friction)
            after = step.a * v + GAIN * step.s1 * (push - against)
            y += step.s1 * v + GAIN * step.s2 * (push - against)
            v = 0.0 if v * after < 0.0 else after
    return np.array(found)


def fits(u, y, noise_sd, runs, seed=1):
    rng = np.random.default_rng(seed)
    return [identify_axis([Record(u=u, y=y + noise_sd * rng.standard_normal(SLOTS), period_s=PERIOD_S)]) for _ in range(runs)]


def test_white_residuals_do_not_show_that_the_intervals_hold():
    """Friction of 1 % under a square wave: white in 98 of 100 fits, and no interval of p holds it; what is not seen is said."""
    found = fits(SQUARE, braked(SQUARE, 0.01), 0.01, 40)
    assert sum(f.residuals.verdict == "white" for f in found) >= 35 and not any(f.pole.covers(POLE) for f in found)
    assert sum(f.friction.covers(0.01) for f in found) >= 35


@pytest.mark.parametrize(("u", "friction", "power"), [(CHIRP, 0.02, 0.93), (SQUARE, 0.05, 0.87)], ids=["chirp", "square"])
def test_friction_is_seen(u, friction, power):
    """Power as measured over 100 runs, a binomial bound of 1e-4 below it; its estimate is within a third."""
    found = fits(u, braked(u, friction), 0.01, 40)
    assert sum(f.friction.low > 0.0 for f in found) >= binom.ppf(1e-4, 40, power)
    assert np.mean([f.friction.value for f in found]) == pytest.approx(friction, rel=0.33)


def test_no_friction_is_seldom_seen():
    """False alarms: 1 to 2 % in a closed and in an open loop, fewer than the binomial's 1e-4 quantile at 2 %."""
    found = square_records(period_s=0.05, slots=440, noise_sd=1e-3, seed=11, runs=80)
    alarms = sum(not identify_axis([record]).friction.covers(0.0) for record in found)
    alarms += sum(not f.friction.covers(0.0) for f in fits(SQUARE, GAIN * forced(SQUARE, POLE, PERIOD_S)[0], 0.01, 80))
    assert alarms <= binom.isf(1e-4, 160, 0.02)


def test_a_motion_that_cannot_show_friction_says_so():
    """An input that never turns: the term is a constant input's response, which the gain holds; the room is beyond the input."""
    u = np.ones(SLOTS)
    found = fits(u, GAIN * forced(u, POLE, PERIOD_S)[0], 0.01, 5)
    assert all(f.friction.low < -1.0 and f.friction.high > 1.0 for f in found)
    still = forced(u, 0.0, PERIOD_S)[0]
    at = dry_friction([Record(u=u, y=still, period_s=PERIOD_S)], 1.0, 0.0, [(0.0, 1.0)], 0.01 * u, still[:, None])
    assert at == (0.0, math.inf)
