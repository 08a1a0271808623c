"""What a session knows of its link before anybody opens it."""

from __future__ import annotations

import pytest

from hil.compose import compose
from hil.errors import HilError
from hil.experiment import load_experiment
from hil.rig.session_link import SessionLink, refuse_unopened
from hil.session import CARRIED
from transport.installed import Folder, Point, points
from transport.links import Closing
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


@pytest.mark.parametrize("error", [OSError("no end"), SystemExit(0)])
def test_a_link_that_cannot_be_closed_is_refused_before_anything_starts(
    error: BaseException, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A SystemExit ended `hil run` with status 0, and nothing had run."""

    class Own(Closing):
        def close(self) -> None:
            raise error

    monkeypatch.setattr("transport.links.opening.open_link", lambda uri, role: Own())
    link = SessionLink(uri="mine:x", traits=LinkTraits(commanders="anybody"), identifiers=None)
    with pytest.raises(HilError, match=rf"^link 'mine:x': {type(error).__name__}: "):
        refuse_unopened(link)
