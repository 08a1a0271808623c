"""A controller of several nodes answers zeros until a packet of each has come: meanwhile the plant moves by itself."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from design.controllers import Known, LoopModel, Sample, SendAll, SensorNodes
from hil.compose.changed import changed
from hil.measure.prediction import predict
from tests.hil.compose.random_scheduled_loops import composed, experiment

RATE = 3.6
"""Of x' = RATE x + 20 u, 1/s: in a slot of 50 ms the squared state of the open plant grows by 1.43."""


def made(loss: float, trigger: dict[str, Any] | None = None) -> dict[str, Any]:
    """Two nodes that measure the same state, of which the controller uses the first; packets of the second get lost."""
    plant = {"kind": "state-space", "A": [[RATE]], "B": [[20.0]], "C": [[1.0], [1.0]], "initial_state": [1.0]}
    changes = experiment(np.random.default_rng(0), plant, controller={"kind": "local", "gain": [[-0.8, 0.0]]})
    changes["network.nodes"]["n1"] |= {} if trigger is None else {"trigger": trigger}
    changes["network.nodes"]["n1"]["law"] = {"kind": "packet", "latency": "5 ms", "loss": loss}
    return changes | {"period": "50 ms"}


def test_a_loop_that_waits_longer_than_its_plant_can_be_left_alone_is_refused() -> None:
    """E x(k)^2 is at least loss^(k + 1) exp(2 RATE k T), whatever the loop does once it acts."""
    for loss in (0.9, 0.75):
        verdict = composed(made(loss)).verdict
        assert verdict is not None and verdict.state == "refused" and "until a packet of every node has come" in verdict.reason
        assert verdict.number == pytest.approx(loss * np.exp(2.0 * RATE * 0.05), rel=1e-9)
    verdict = composed(made(0.65)).verdict  # 0.93 a slot
    assert verdict is not None and verdict.certified


def test_a_node_with_a_trigger_is_not_waited_for() -> None:
    """Its output counts as 0 meanwhile, and the loop acts at once."""
    states = []
    for trigger in (None, {"kind": "relative", "threshold": 0.01}):
        changes = made(0.8, trigger)
        changes["network.nodes"]["n1"].pop("law")
        changes["network.nodes"]["n2"] = {"outputs": ["y3"]}
        changes["plant"] = changes["plant"] | {"C": [[1.0], [1.0], [1.0]]}
        changes["controller"] = {"kind": "local", "gain": [[-0.4, 0.0, -0.4]]}
        changes["network.media"] = {"bus": {"kind": "random", "nodes": ["n1", "n0"], "probabilities": [0.1, 0.9]}}
        verdict = composed(changes).verdict
        assert verdict is not None
        states.append((verdict.state, "until a packet" in verdict.reason))
    assert states == [("refused", True), ("certified", False)]


def test_a_node_without_a_packet_yet_counts_as_the_oldest() -> None:
    """A controller that does not wait for it takes the gains that the certificate has for a sample of long ago."""
    gains = tuple((((float(i), 0.0),),) for i in range(1, 7))
    nodes = SensorNodes(names=("a", "b"), outputs=((0,), (1,)), buffers=(1, 1), delays=(None, None), silent=("b",))
    model = LoopModel(A=np.eye(1), B=np.eye(1), C=np.ones((2, 1)), period_s=0.1, tau_max=2, d_max=0, sensors=nodes)
    running = SendAll(gains=gains, selection="constant", ages=(2, 3)).start(model)
    row = running.rows(5, Known((Sample(0, 5, (1.0,)),), (0.0, 0.0)))
    assert row == ((3.0,),)  # of the ages (0, 2): the third table


def test_nothing_is_predicted_of_a_loop_that_waits_for_its_second_node() -> None:
    """The prediction has the gains act from slot 0 on; of this loop it was wrong by 26 standard errors of 300 runs."""
    plant = {
        "kind": "state-space", "A": [[0.0, 1.0], [0.0, -1.0]], "B": [[0.0], [1.0]], "C": [[1.0, 0.0], [0.0, 1.0]],
        "initial_state": [1.0, 0.0],
    }
    waits = made(0.9) | {"plant": plant, "controller": {"kind": "local", "gain": [[-2.0, -2.0]]}}
    assert predict(composed(waits), 40) is None
    waits["network.nodes"]["n1"]["law"]["loss"] = 0.0
    assert predict(composed(waits), 40) is not None


def test_a_law_that_loses_more_in_the_run_is_not_refused_for_a_wait_that_may_be_over() -> None:
    loop = composed(made(0.1))
    assert loop.verdict is not None and loop.verdict.certified
    verdict = changed(loop, 100, "network.nodes.n1.law.loss", 0.9).verdict
    assert verdict is not None and verdict.state == "undecided" and "which nodes a packet has come of by then" in verdict.reason
