"""hil check controllers mine:Mine says more."""

import os

EXPERIMENT = os.path.join(os.path.dirname(__file__), "mine.toml")


def test_the_loop_is_certified_and_tracks_its_reference(hil):
    session = hil.run(EXPERIMENT, seed=1)
    assert session.status == 0
    assert session.summary["certificate"]["state"] == "certified"
    assert abs(session.arrays["/plant/state"]["angle"][-1] - 3.0) < 0.3


def test_most_steps_are_tracked(hil):
    hil.assert_probability(EXPERIMENT, lambda s: s.metrics["sse"] < 20.0, at_least=0.9)
