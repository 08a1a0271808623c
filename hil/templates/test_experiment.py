"""Run it: pytest. In real time over a link: pytest --hil-clock real."""

import os

EXPERIMENT = os.path.join(os.path.dirname(__file__), "mine.toml")


def test_the_loop_is_certified_and_tracks_its_reference(hil):
    session = hil.run(EXPERIMENT, seed=1)
    assert session.status == 0
    assert session.summary["certificate"]["state"] == "certified"
    assert session.metrics["sse"] < 20.0
