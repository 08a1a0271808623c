"""What the live page shows of a run: which network laws may change, by the path of their tables."""

from __future__ import annotations

import numpy as np
import pytest

from hil.compose.loop import compose
from hil.experiment import Experiment, load_experiment
from hil.pages.live.about import about, controllers, controllers_of, presets
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


def test_the_laws_that_a_page_offers_keep_the_longest_delay_and_differ_in_how_often_it_grows() -> None:
    found = presets(2)
    worse = {"seldom late": 0.05, "often late": 0.5, "mostly late": 0.9}
    for name, p in worse.items():
        assert np.allclose(found.pop(name)["matrix"], [[1.0 - p, p, 0.0], [1.0 - p, 0.0, p], [1.0 - p, 0.0, p]])
    assert found == {"no delay": {"kind": "constant", "age": 0}, "always late": {"kind": "constant", "age": 2}}
    assert presets(0) == {"no delay": {"kind": "constant", "age": 0}}


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
