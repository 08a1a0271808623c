"""hil check measures mine:Mine says more."""

import os

EXPERIMENT = os.path.join(os.path.dirname(__file__), "mine.toml")


def test_the_effort_is_measured_and_grows_with_time(hil):
    short, whole = (hil.run(EXPERIMENT, seed=1, duration=seconds).metrics["effort"] for seconds in (2, 10))
    assert 0.0 < short < whole
