"""hil check plants mine:Mine says more."""

import os

from mine import Mine

from plants import check_plant

EXPERIMENT = os.path.join(os.path.dirname(__file__), "mine.toml")


def test_the_plant_keeps_what_every_plant_must_keep():
    check_plant(Mine())


def test_the_loop_is_certified_and_tracks_its_reference(hil):
    session = hil.run(EXPERIMENT, seed=1)
    assert session.status == 0
    assert session.summary["certificate"]["state"] == "certified"
    assert session.metrics["sse_after_5s"] < 0.01
