"""A verdict speaks of the network that the laws state: how they begin, what they never come to, and why nothing is known."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from design.verdict import Verdict
from hil.api.experiment_source import load_experiment
from hil.compose import compose
from hil.compose.judged import caution
from hil.errors import ExperimentError
from hil.rig.loop import Loop
from hil.runtime.virtual import simulate

CALM = {"kind": "constant", "age": 0}
TWO_CLASSES = [[1.0, 0.0], [0.0, 1.0]]
TRANSIENT = [[1.0, 0.0], [0.5, 0.5]]
SWAPS = [[0.0, 1.0], [1.0, 0.0]]


def verdict(**links: Any) -> Verdict:
    found = loop_over(**links).verdict
    assert found is not None
    return found


def loop_over(**links: Any) -> Loop:
    plant = {"kind": "state-space", "A": [[2.0]], "B": [[1.0]], "C": [[1.0]], "initial_state": [1.0]}
    controller = {"kind": "send-all", "selection": "constant", "gains": [[[[-6.0]]], [[[0.0]]]]}
    changes = {"plant": plant, "controller": controller, "limits": {}, "reference": [], "disturbance": []}
    return compose(load_experiment("dc-motor-h2", allow_uncertified=True, **{"network.ca.law": CALM} | changes | links))


@pytest.mark.parametrize(("matrix", "initial"), [(TWO_CLASSES, [1.0, 0.0]), (TRANSIENT, None)])
def test_modes_that_the_law_never_comes_to_decide_nothing(matrix: list[list[float]], initial: list[float] | None) -> None:
    law: dict[str, Any] = {"kind": "markov", "allow_absorbing": True, "matrix": matrix}
    law |= {} if initial is None else {"initial": initial}
    found = verdict(**{"network.sc.law": law})
    assert found.certified and found.number is not None and found.number < 1.0, found.reason
    assert any("never comes to 1 of their modes" in said for said in found.assumptions)
    assert not caution(loop_over(**{"network.sc.law": law}))
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


def test_modes_that_are_never_met_decide_nothing_beside_a_recording() -> None:
    law = {"kind": "markov", "allow_absorbing": True, "matrix": TWO_CLASSES, "initial": [1.0, 0.0]}
    recorded = {"kind": "trace", "ages": [0]}
    assert verdict(**{"network.sc.law": law, "network.ca.law": recorded}).certified
    other = law | {"initial": [0.5, 0.5]}
    assert verdict(**{"network.sc.law": other, "network.ca.law": recorded}).state == "refused"


@pytest.mark.parametrize("back", [{"kind": "markov", "matrix": SWAPS, "initial": [1.0, 0.0]}, {"kind": "trace", "ages": [0, 1]}])
def test_two_laws_that_repeat_keep_their_phase(back: dict[str, Any]) -> None:
    """Both ages take turns: together, the tables of age 0 act alone, as the run shows; apart, those of age 1."""
    plant = {"kind": "state-space", "A": [[1.0]], "B": [[1.0]], "C": [[1.0]], "initial_state": [1.0]}
    gains = [[[[-6.0]], [[-6.0]]], [[[50.0]], [[50.0]]]]
    laws: dict[str, Any] = {"network.sc.max_age": 1, "network.ca.max_age": 1, "network.ca.law": back}
    laws |= {"plant": plant, "controller": {"kind": "send-all", "selection": "applied", "gains": gains}, "duration": "5 s"}
    cases = (([1.0, 0.0], "certified"), ([0.0, 1.0], "refused"), ("stationary", "refused"), ([0.5, 0.0, 0.5, 0.0], "certified"))
    for first, state in cases:
        law = {"kind": "markov", "matrix": SWAPS, "initial": first}
        if len(first) == 4:  # two cycles, in each of which the laws keep their phase
            law |= {"matrix": np.kron(np.eye(2), SWAPS).tolist(), "ages": [0, 1, 0, 1]}
        changes = {"limits": {}, "reference": [], "disturbance": [], "allow_uncertified": True}
        loop = compose(load_experiment("dc-motor-h2", **{"network.sc.law": law}, **laws, **changes))
        assert loop.verdict is not None and loop.verdict.state == state, (first, loop.verdict.reason)
        if first != "stationary":
            x = simulate(loop, 0, ["/plant/state"]).arrays["/plant/state"]["x1"]
            assert (abs(x[-1]) < 1e-3) == (state == "certified")
