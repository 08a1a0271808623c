"""A verdict speaks of the network that the laws state: how they begin, what they never come to, and why nothing is known."""

from __future__ import annotations

from typing import Any

import pytest

from design.verdict import Verdict
from hil.api.experiment_source import load_experiment
from hil.compose.loop import compose
from hil.errors import ExperimentError

CALM = {"kind": "constant", "age": 0}
TWO_CLASSES = [[1.0, 0.0], [0.0, 1.0]]
TRANSIENT = [[1.0, 0.0], [0.5, 0.5]]


def verdict(**links: Any) -> Verdict:
    plant = {"kind": "state-space", "A": [[2.0]], "B": [[1.0]], "C": [[1.0]], "initial_state": [1.0]}
    controller = {"kind": "send-all", "selection": "constant", "gains": [[[[-6.0]]], [[[0.0]]]]}
    changes = {"plant": plant, "controller": controller, "limits": {}, "reference": [], "disturbance": [], **links}
    loop = compose(load_experiment("dc-motor-h2", allow_uncertified=True, **{"network.ca.law": CALM}, **changes))
    assert loop.verdict is not None
    return loop.verdict


@pytest.mark.parametrize(("matrix", "initial"), [(TWO_CLASSES, [1.0, 0.0]), (TRANSIENT, None)])
def test_modes_that_the_law_never_comes_to_decide_nothing(matrix: list[list[float]], initial: list[float] | None) -> None:
    law: dict[str, Any] = {"kind": "markov", "allow_absorbing": True, "matrix": matrix}
    law |= {} if initial is None else {"initial": initial}
    found = verdict(**{"network.sc.law": law})
    assert found.certified and found.number is not None and found.number < 1.0, found.reason
    assert any("never comes to 1 of their modes" in said for said in found.assumptions)
    other = verdict(**{"network.sc.law": {**law, "matrix": TWO_CLASSES, "initial": [0.5, 0.5]}})
    assert other.state == "refused"


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        ({"network.nodes.sensor": {"outputs": ["angle"], "clock": {"every": 2}}},
         "network.nodes.sensor.clock: a node sends in one of 2 slots"),
        ({"network.nodes.sensor": {"outputs": ["angle"], "trigger": {"kind": "error", "threshold": 0.1}}},
         ".sensor.trigger (error)"),
        ({"network.sc.law": {"kind": "trace", "ages": [0, 1]}}, "the law of network.sc states no chain"),
    ],
)
def test_a_design_and_a_verdict_name_what_keeps_the_network_from_having_a_chain(change: dict[str, Any], cause: str) -> None:
    """A clock and a trace keep a design from it, and no verdict."""
    try:
        with pytest.raises(ExperimentError, match="needs a chain of ages on both links, but") as refused:
            compose(load_experiment("dc-motor-ours-h2", **change))
        assert cause in str(refused.value)
        found = compose(load_experiment("dc-motor-h2", allow_uncertified=True, **change)).verdict
        assert found is not None and (found.state == "undecided") == (cause in found.reason) == ("trigger" in cause)
    except ExperimentError as error:
        pytest.fail(str(error))
