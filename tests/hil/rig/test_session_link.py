"""What a session knows of its link before anybody opens it."""

from __future__ import annotations

import pytest

from hil.compose import compose
from hil.experiment import load_experiment
from hil.rig.session_link import SessionLink
from hil.session import CARRIED
from transport.installed import Folder, Point, points
from transport.links.traits import LinkTraits


def test_a_link_of_ones_own_without_codes_is_one_that_a_certificate_assumes_to_carry_what_it_is_given(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ours = points("hil.links")
    mine = Point("hil.links", "mine", "my_module:Link", Folder(""))
    monkeypatch.setattr("transport.links.opening.points", lambda begin: [*ours, mine])
    links = ("mine:x", "mine:x?auth=frames.key", "can:hil:rig0", "zenoh:tcp/127.0.0.1:7447", "local:")
    traits = [LinkTraits(commanders="anybody", keyed="auth=" in uri) for uri in links]
    unproved = [SessionLink(uri=uri, traits=each, identifiers=None).unproved for uri, each in zip(links, traits)]
    assert unproved == [True, False, False, False, False]


def test_the_assumption_stands_in_the_certificate_of_a_certified_loop_alone() -> None:
    found = compose(load_experiment("dc-motor-h2")).assuming(CARRIED).verdict
    assert found is not None and found.certified and found.assumptions[-1] == CARRIED
    loop = compose(load_experiment("dc-motor-ours-integral", ["controller.integral_limit=[]", "allow_uncertified=true"]))
    assert loop.assuming(CARRIED) is loop
