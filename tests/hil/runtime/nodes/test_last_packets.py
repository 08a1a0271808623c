"""Gains on the last packets on the rig: the run is the theory's, outcome by outcome."""

from __future__ import annotations

import numpy as np
import pytest

from design.controllers.sensor_nodes import PacketWindow, window_of
from design.historical_data.gapped_history import window_mask
from design.historical_data.lifted_loop import close
from hil.certify.historical_loop import delayed_plant_of
from hil.compose.loop import compose
from hil.errors import HilError
from hil.experiment import load_experiment
from hil.rig.loop import Loop
from hil.rig.normal_form import rig_of
from hil.runtime.virtual import simulate
from transport.draws import DELIVERED

SETS = {
    "random": ["network.media.bus={kind='random', nodes=['first', 'second', 'third', 'fourth'], loss=0.3}"],
    "cycle": ["network.media.bus.loss=0.3"],
}


def with_gains(which: str, length: int, *sets: str) -> Loop:
    """multisensor-ours under small random gains on the last packets."""
    free = load_experiment("multisensor-ours", ["duration=2", "allow_uncertified=true", *SETS[which]])
    nodes = rig_of(free).nodes
    assert nodes is not None and nodes.turns is not None
    mask = window_mask(nodes, PacketWindow(turns=nodes.turns, length=length), length + 1)
    gains = np.random.default_rng(length).normal(size=mask.shape) * mask
    table = f"controller={{kind='historical', uses='last-packets', gains={gains[:, :, None, :].tolist()}}}"
    return compose(load_experiment("multisensor-ours", ["duration=2", *SETS[which], table, *sets]))


@pytest.mark.parametrize(("which", "length"), [("random", 1), ("random", 2), ("cycle", 1), ("cycle", 3)])
def test_a_run_is_what_the_matrices_of_its_outcomes_say(which: str, length: int) -> None:
    loop = with_gains(which, length)
    assert loop.verdict is not None and loop.verdict.certified
    nodes, plant = loop.model.sensors, delayed_plant_of(loop.experiment.plant, loop.model)
    assert nodes is not None and nodes.turns is not None and plant is not None
    K = loop.controller.history()  # type: ignore[attr-defined]
    window, L = window_of(nodes.turns, len(K)), close(plant, K).L
    for seed in (0, 1):
        run = simulate(loop, seed)
        draws, states = run.arrays["/network/sc"], run.arrays["/plant/state"]
        came = {int(d["slot"]): int(d["node"]) for d in draws if d["reason"] == DELIVERED}
        assert 20 <= len(came) < 40
        X = np.zeros(L.shape[-1])
        X[:4] = loop.experiment.plant.initial_state  # type: ignore[attr-defined]
        for k in range(40):
            np.testing.assert_allclose([states[f"x{i + 1}"][k] for i in range(4)], X[:4], atol=2e-5)
            X = L[window.phase(k, came.get)] @ X


def test_gains_on_a_packet_that_the_outcome_lacks_are_refused_by_their_entry() -> None:
    K = np.zeros((25, 1, 1, 4))
    K[4 + 5 * 4, 0, 0, 2] = 1.0  # nothing came in both slots
    table = f"controller={{kind='historical', uses='last-packets', gains={K.tolist()}}}"
    with pytest.raises(HilError, match=r"controller.gains\[24\]\[0\]\[0\]\[2\]: 1, expected 0"):
        compose(load_experiment("multisensor-ours", [*SETS["random"], table]))
    with pytest.raises(HilError, match=r"controller\.gains: 24 phases, but the last packets of this schedule have 5"):
        compose(load_experiment("multisensor-ours", [*SETS["random"], table.replace(str(K.tolist()), str(K[:24].tolist()))]))


def test_the_last_packets_are_undecided_where_they_come_late() -> None:
    late = "network.sc.law={kind='constant', age=1}"
    with pytest.raises(HilError, match="the last packets where they take no slot"):
        compose(load_experiment("multisensor-ours", [*SETS["random"], late, "controller.uses='last-packets'"]))
