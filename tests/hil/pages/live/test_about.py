"""What the live page shows of a run: which network laws may change, by the path of their tables."""

from __future__ import annotations

import pytest

from hil.compose.loop import compose
from hil.experiment import load_experiment
from hil.pages.live.about import about
from hil.pages.live.side import Side


@pytest.mark.parametrize(
    ("name", "paths"),
    [("dc-motor-two-nodes", {"ca", "nodes.angle", "nodes.speed"}), ("dc-motor-smith", {"ca", "sc"})],
)
def test_each_node_has_the_law_of_its_own_way_and_a_single_one_that_of_the_network(name: str, paths: set[str]) -> None:
    side = Side()
    side.begin(compose(load_experiment(name)), {})
    assert set(about([side], "here")["runs"][0]["network"]) == paths
