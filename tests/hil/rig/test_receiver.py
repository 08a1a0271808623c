"""Packets on their way of nodes that take turns or have clocks: beside the closed form of a node that sends in every slot."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from design.verdict import Verdict
from tests.hil.compose.random_scheduled_loops import composed, experiment

BURSTS = {"p_gb": 0.2, "p_bg": 0.4, "loss_good": 0.05, "loss_bad": 0.7}
SPREAD = {"dist": "uniform", "loc": "5 ms", "scale": "140 ms"}
LAWS = {
    "loss": {"latency": "5 ms", "loss": 0.3},
    "overtaking": {"latency": SPREAD, "loss": 0.2},
    "in order": {"latency": SPREAD, "loss": 0.2, "reordering": False},
    "in order, bursts": {"latency": SPREAD, "loss": BURSTS, "reordering": False},
    "copies": {"latency": SPREAD, "loss": 0.2, "duplication": 0.5},
    "bursts": {"latency": SPREAD, "loss": BURSTS},
    "discarded": {"latency": {"dist": "gamma", "a": 2.0, "scale": "40 ms"}, "loss": 0.1, "discard_older": 1},
}  # fmt: skip


def judged(law: dict[str, Any], **changes: Any) -> Verdict:
    plant = {"kind": "state-space", "A": [[1.0]], "B": [[6.0]], "C": [[1.0]], "initial_state": [1.0]}
    gains = [[[[-1.4]]], [[[-0.9]]], [[[-0.6]]]]
    made = experiment(np.random.default_rng(0), plant, controller={"kind": "send-all", "selection": "constant", "gains": gains})
    made |= {"period": "50 ms", "network.nodes": {"n": {"outputs": ["y1"]} | changes.pop("node", {})}}
    made |= {"network.sc": {"max_age": 2, "law": {"kind": "packet"} | law}, "network.ca": {"law": {"kind": "constant", "age": 0}}}
    verdict = composed(made | changes).verdict
    assert verdict is not None and verdict.number is not None
    return verdict


@pytest.mark.parametrize("name", LAWS)
def test_a_medium_of_one_node_changes_nothing(name: str) -> None:
    """The closed form has the ages alone, the channel every packet on its way: two chains of one loop."""
    alone = judged(LAWS[name])
    shared = judged(LAWS[name], **{"network.media": {"bus": {"kind": "round-robin", "nodes": ["n"]}}})
    assert shared.number == pytest.approx(alone.number, rel=1e-9) and shared.state == alone.state
    assert shared.details["modes"] != alone.details["modes"]


@pytest.mark.parametrize("loss", [0.1, 0.6])
def test_a_clock_and_losses_are_the_mean_over_the_packets_of_its_slots(loss: float) -> None:
    """x(k+1) = a x + b K z: z = x in every second slot with probability 1 - loss, else held; over two slots by hand."""
    law, local = {"latency": "5 ms", "loss": loss}, {"kind": "local", "gain": [[-0.9]]}
    found = judged(law, node={"clock": {"every": 2}}, controller=local)
    both = expm(np.array([[1.0, 6.0], [0.0, 0.0]]) * 0.05)
    held = np.array([[both[0, 0], -0.9 * both[0, 1]], [0.0, 1.0]])
    new = held @ np.array([[1.0, 0.0], [1.0, 0.0]])
    moments = loss * np.kron(held @ held, held @ held) + (1.0 - loss) * np.kron(held @ new, held @ new)
    assert found.number == pytest.approx(np.sqrt(np.abs(np.linalg.eigvals(moments)).max()), rel=1e-9)


def test_a_band_over_packets_that_all_come_alike_is_that_over_a_constant_age() -> None:
    given = {"controller": {"kind": "local", "gain": [[-0.9]]}, "node": {"trigger": {"kind": "dead-band", "threshold": 0.1}}}
    packets, age = (judged(law, **given) for law in ({"latency": "5 ms"}, {"kind": "constant", "age": 0}))
    assert packets.number == pytest.approx(age.number, rel=1e-9) and packets.state == age.state
