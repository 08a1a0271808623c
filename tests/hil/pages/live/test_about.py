"""What the live page shows of a run: which network laws may change, by the path of their tables."""

from __future__ import annotations

import pytest

from hil.compose.loop import compose
from hil.experiment import Experiment, load_experiment
from hil.pages.live.about import about, controllers, controllers_of
from hil.pages.live.side import Side
from hil.runtime.time.clock import PacedClock


@pytest.mark.parametrize(
    ("name", "paths"),
    [("dc-motor-two-nodes", {"ca", "nodes.angle", "nodes.speed"}), ("dc-motor-smith", {"ca", "sc"})],
)
def test_each_node_has_the_law_of_its_own_way_and_a_single_one_that_of_the_network(name: str, paths: set[str]) -> None:
    side = Side()
    side.begin(compose(load_experiment(name)), {})
    assert set(about([side], "here")["runs"][0]["network"]) == paths


def test_the_page_waits_for_no_other_experiment(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a page is drawn from loads nothing; the controllers that it offers come behind it."""
    side = Side(PacedClock(), acts=True)
    assert about([side], "here")["runs"] == [{"name": "", "traces": [], "waits": ""}] and controllers_of(side) == {}
    side.begin(compose(load_experiment("dc-motor-hinf")), {})
    loaded: list[str] = []

    def load(name: str) -> Experiment:
        loaded.append(name)
        return load_experiment(name)

    monkeypatch.setattr(f"{about.__module__}.load_experiment", load)
    controllers.cache_clear()
    assert about([side], "here")["runs"][0]["name"] == "dc-motor-hinf" and not loaded
    assert "dc-motor-h2" in controllers_of(side) and "dc-motor-h2" in loaded
