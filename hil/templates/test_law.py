"""hil check laws mine:Mine says more."""

import os

from mine import Mine

from hil.plugins.checks import check_law

EXPERIMENT = os.path.join(os.path.dirname(__file__), "mine.toml")


def test_the_law_keeps_what_every_law_must_keep():
    assert any("ChainLaw" in said for said in check_law(Mine()))


def test_the_delays_of_a_run_are_those_of_the_law(hil):
    session = hil.run(EXPERIMENT, seed=1)
    assert session.summary["certificate"]["state"] == "certified"
    hil.assert_law(session, "sc")
