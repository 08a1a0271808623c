"""Media that lose packets, and gains on all that has come or on the last packets: the run is the theory's, its verdict known."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from design.controllers import Historical, Known, LoopModel, SensorNodes, Turns
from design.controllers.sensor_nodes import PacketWindow, window_of
from design.historical_data import DelayedPlant, close
from design.historical_data.gapped_history import gap_window, gapped_gains, gaps_undecided, phase_gains, window_mask
from design.historical_data.guaranteed_cost import close_received
from design.historical_data.sensor_schedule import mask_of
from design.jump_linear.second_moment import forward
from design.requests.historical import historical_of
from hil.certify.historical_loop import delayed_plant_of, judge_historical
from hil.compose import compose
from hil.errors import HilError
from hil.experiment import load_experiment
from hil.rig import rig_of
from hil.rig.loop import Loop
from hil.runtime.nodes.controller_input import SampleHistory
from hil.runtime.virtual import simulate
from transport.draws import DELIVERED

SETS = {
    "three samples": ["network.media.bus.loss=0.6"],
    "unlike nodes": [
        "network.media.bus.loss=0.5", "network.nodes.first.buffer=1", "network.nodes.second.buffer=2", "network.sc.max_age=2",
        "network.nodes.second.law={kind='constant', age=2}", "network.nodes.third.law={kind='constant', age=1}",
    ],
    "all late": ["network.media.bus.loss=0.5", "network.sc.law.age=1", "plant.initial_history=[[1, 2, -3, 0.5], [0, 4, 1, 1]]"],
}  # fmt: skip


def with_gains(which: str, *sets: str) -> Loop:
    """multisensor-ours under random gains on every sample that a round robin brings."""
    free = load_experiment("multisensor-ours", ["duration=2", "allow_uncertified=true", *SETS[which], *sets])
    mask = mask_of(rig_of(free).nodes, 5, "history")
    gains = np.random.default_rng(1).normal(size=mask.shape) * mask
    table = f"controller={{kind='historical', gains={gains[:, :, None, :].tolist()}}}"
    return compose(load_experiment("multisensor-ours", ["duration=2", *SETS[which], table, *sets]), certify=False)


@pytest.mark.parametrize("which", SETS)
def test_a_run_is_what_the_matrices_of_its_outcomes_say(which: str) -> None:
    """Samples from before the window are held, and those that a newer packet made the controller forget act as 0."""
    loop = with_gains(which)
    nodes, plant = loop.model.nodes, delayed_plant_of(loop.experiment.plant, loop.model)
    assert plant is not None
    each = gapped_gains(loop.controller.history(), nodes)  # type: ignore[attr-defined]
    window = gap_window(nodes, each.gains.shape[1] - 2)
    loops = [close_received(plant, each.gains, renewed=each.renewed)]
    past = np.array([loop.experiment.plant.initial_state, *loop.experiment.plant.initial_history])  # type: ignore[attr-defined]
    if len(past) == 1:
        loops.append(close(plant, each.gains, renewed=each.renewed))
    late, held = min(delay or 0 for delay in nodes.delays), 0
    for seed in (0, 1):
        run = simulate(loop, seed)
        draws, states = run.arrays["/network/sc"], run.arrays["/plant/state"]
        came = {int(d["packet_slot"]) + late: int(d["node"]) for d in draws if d["reason"] == DELIVERED}
        for closed in loops:
            z = np.zeros(closed.L.shape[-1])
            z[: past.size] = past.ravel()
            z[24:28] = past[0] if closed is loops[0] else 0.0
            for k in range(40):
                np.testing.assert_allclose([states[f"x{i + 1}"][k] for i in range(4)], z[:4], rtol=2e-5, atol=2e-5)
                phase = window.phase(k, came.get)
                held += bool(np.any(each.gains[phase, 6] @ z[-4:]))
                z = closed.L[phase] @ z
    assert held > 10


def two_nodes(loss: float) -> SensorNodes:
    """Two nodes in turn, one output each."""
    turns = Turns(order=(0, 1), phase=1, loss=loss)
    return SensorNodes(names=("a", "b"), outputs=((0,), (1,)), buffers=(1, 1), delays=(0, 0), turns=turns)


def test_second_moments_are_those_of_all_paths_of_the_controller_that_runs() -> None:
    """Seven slots, 128 paths, each with the controller's own memory of samples."""
    nodes, loss, A, B, slots = two_nodes(0.4), 0.4, np.array([[1.1, 0.3], [-0.2, 0.9]]), np.array([[0.5], [1.0]]), 7
    K = np.random.default_rng(2).normal(size=(2, 3, 1, 2)) * mask_of(nodes, 2, "history")[:, :, None, :]
    each = phase_gains(K, nodes, "history")
    plant = DelayedPlant(A=A, delayed=np.zeros((0, 2, 2)), B=B, weight=np.eye(2))
    closed = close(plant, each.gains, each.transition, renewed=each.renewed)
    S = np.zeros_like(closed.L)
    S[:, 0, 0], S[:, 1, 1], S[:, 0, 1], S[:, 1, 0] = (each.start * v for v in (1.0, 4.0, -2.0, -2.0))
    said = [S[:, :2, :2].sum(axis=0)]
    for _ in range(slots):
        S = forward(closed.L, closed.transition, S)
        said.append(S[:, :2, :2].sum(axis=0))
    law: Historical = historical_of(K, "history")
    model = LoopModel(A=A, B=B, C=np.eye(2), period_s=0.1, tau_max=0, d_max=0, sensors=nodes)
    sensors = unstable(0.1).rig.sensors
    seen = np.zeros((slots + 1, 2, 2))
    for path in product((True, False), repeat=slots):
        share, x = float(np.prod([1.0 - loss if came else loss for came in path])), np.array([1.0, -2.0])
        running, assembly = law.start(model), SampleHistory(sensors, 2)
        for k, came in enumerate(path):
            seen[k] += share * np.outer(x, x)
            node = (k + 1) % 2
            if came:
                assembly.take(node, k, (float(x[node]),))
            x = A @ x + B @ running.rows(k, Known(assembly.known(k), ()))[0]
        seen[slots] += share * np.outer(x, x)
    np.testing.assert_allclose(seen, said, rtol=1e-9, atol=1e-12)


PLANT = [
    "plant={kind='delayed-states', A=[[1.2, 0.0], [0.0, 0.5]], delayed=[], B=[[1.0], [0.0]], initial_state=[1.0, 1.0]}",
    "plant.weight=[[1.0, 0.0], [0.0, 1.0]]",
    "network.nodes={first={outputs=['x1']}, second={outputs=['x2']}}",
    "network.media.bus.nodes=['first', 'second']", "limits.state={}",
]  # fmt: skip


def unstable(loss: float, *sets: str) -> Loop:
    """x1 grows by 1.2 a slot, and is brought near 0 by the newest sample of every other slot."""
    gains = np.zeros((2, 2, 1, 2))
    gains[0, 0, 0, 0], gains[1, 1, 0, 0] = -0.9, -0.1
    table = f"controller={{kind='historical', gains={gains.tolist()}}}"
    return compose(load_experiment("multisensor-ours", [*PLANT, table, f"network.media.bus.loss={loss}", *sets]))


def test_losses_turn_certified_into_refused() -> None:
    few, more = unstable(0.05), unstable(1e-9)
    assert few.verdict is not None and few.verdict.certified and more.verdict is not None
    assert few.verdict.details["cost"] > 1.01 * more.verdict.details["cost"]
    assert "packets are lost on the medium as it states, and nowhere else" in few.verdict.assumptions
    assert judge_historical(few)["mean_cost"] > judge_historical(more)["mean_cost"]
    with pytest.raises(HilError, match=r"refused: E\|X\|\^2 of the stacked state does not fall"):
        unstable(0.7)
    with pytest.raises(HilError, match="--spread: not over a history with lost packets"):
        judge_historical(few, spread=True)


def test_what_is_not_known_is_said_with_its_number() -> None:
    assert not gaps_undecided(two_nodes(0.1), 7)
    said = gaps_undecided(two_nodes(0.1), 8)
    assert said.startswith("which of the last 9 packets got lost decides what a history has: 1024 phases with the turns")
    assert "512 phases and 198 states: 20072448 numbers" in gaps_undecided(two_nodes(0.1), 7, 97)
    with pytest.raises(HilError, match="over lost packets gains are designed for uses = 'current-packet' or 'last-packets'"):
        compose(load_experiment("multisensor-ours", ["network.media.bus.loss=0.1"]))


LAST = {
    "random": ["network.media.bus={kind='random', nodes=['first', 'second', 'third', 'fourth'], loss=0.3}"],
    "cycle": ["network.media.bus.loss=0.3"],
}


def on_last_packets(which: str, length: int, *sets: str) -> Loop:
    """multisensor-ours under small random gains on the last packets."""
    free = load_experiment("multisensor-ours", ["duration=2", "allow_uncertified=true", *LAST[which]])
    nodes = rig_of(free).nodes
    assert nodes is not None and nodes.turns is not None
    mask = window_mask(nodes, PacketWindow(turns=nodes.turns, length=length), length + 1)
    gains = np.random.default_rng(length).normal(size=mask.shape) * mask
    table = f"controller={{kind='historical', uses='last-packets', gains={gains[:, :, None, :].tolist()}}}"
    return compose(load_experiment("multisensor-ours", ["duration=2", *LAST[which], table, *sets]))


@pytest.mark.parametrize(("which", "length"), [("random", 1), ("random", 2), ("cycle", 1), ("cycle", 3)])
def test_a_run_on_the_last_packets_is_what_the_matrices_of_its_outcomes_say(which: str, length: int) -> None:
    loop = on_last_packets(which, length)
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
        compose(load_experiment("multisensor-ours", [*LAST["random"], table]))
    with pytest.raises(HilError, match=r"controller\.gains: 24 phases, but the last packets of this schedule have 5"):
        compose(load_experiment("multisensor-ours", [*LAST["random"], table.replace(str(K.tolist()), str(K[:24].tolist()))]))


def test_the_last_packets_are_undecided_where_they_come_late() -> None:
    late = "network.sc.law={kind='constant', age=1}"
    with pytest.raises(HilError, match="the last packets where they take no slot"):
        compose(load_experiment("multisensor-ours", [*LAST["random"], late, "controller.uses='last-packets'"]))
