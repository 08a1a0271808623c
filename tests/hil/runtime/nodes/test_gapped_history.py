"""Media that lose packets, and gains on all that has come or on the last packets: the run is the theory's, its verdict known."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from msgspec.structs import replace

from design.controllers import Historical, Known
from design.controllers.sensor_nodes import PacketWindow, window_of
from design.historical_data import DelayedPlant, close
from design.historical_data.guaranteed_cost import run_from
from design.historical_data.sensor_schedule import PhaseGains, mask_of, window_mask
from design.jump_linear.second_moment import forward
from design.requests.historical import historical_of
from hil.certify.historical_loop import delayed_plant_of, judge_historical, with_commands
from hil.compose import compose
from hil.errors import HilError
from hil.experiment import load_experiment
from hil.rig import rig_of
from hil.rig.loop import Loop
from hil.rig.loop_chains import history_of
from hil.runtime.nodes.controller_input import SampleHistory
from hil.runtime.virtual import simulate
from transport.draws import DELIVERED

NODES = ["first", "second", "third", "fourth"]
CLOCKS = [f"network.nodes.{name}.clock={{every={n + 2}, phase={n}}}" for n, name in enumerate(NODES)]
BUS = "network.media.bus={{kind='can-arbitration', nodes=['first', 'second', 'third', 'fourth'], frames=1, loss={loss}}}"
UNIFORM = "latency={dist='uniform', loc=0.0, scale=0.18}"
SETS = {
    "three samples": ["network.media.bus.loss=0.6"],
    "unlike nodes": [
        "network.media.bus.loss=0.5", "network.nodes.first.buffer=1", "network.nodes.second.buffer=2", "network.sc.max_age=2",
        "network.nodes.second.law={kind='constant', age=2}", "network.nodes.third.law={kind='constant', age=1}",
    ],
    "all late": ["network.media.bus.loss=0.5", "network.sc.law.age=1", "plant.initial_history=[[1, 2, -3, 0.5], [0, 4, 1, 1]]"],
    "clocks": [*CLOCKS, "network.media={}", "network.nodes.second.buffer=1"],
    "clocks and turns": [*CLOCKS[:2], "network.nodes.second.buffer=1"],
    "a bus that loses frames": [
        *(f"network.nodes.{name}.clock={{every=4, phase={n}}}" for n, name in enumerate(["first", "third", "fourth", "second"])),
        BUS.format(loss=0.3), "plant.initial_history=[[1, 2, -3, 0.5]]",
    ],
    "late by a chain": [
        "network.nodes.third.law={kind='markov', matrix=[[0.5, 0.3, 0.2], [0.6, 0.2, 0.2], [0.4, 0.3, 0.3]], allow_gaps=true}",
        "network.sc.max_age=2",
    ],
    "late packets": [
        f"network.nodes.first.law={{kind='packet', loss=0.2, {UNIFORM}}}", "network.sc.max_age=3", "network.media={}",
        "network.nodes.first.buffer=1",
    ],
    "late packets in order": [
        f"network.nodes.first.law={{kind='packet', loss=0.2, reordering=false, {UNIFORM}}}", "network.sc.max_age=3",
    ],
    "a recording": [
        "network.nodes.second.law={kind='trace', ages=[0, 3, 1, 1, 3, 2], allow_gaps=true}", "network.sc.max_age=3",
        "network.media={}", "network.nodes.second.buffer=1",
    ],
    "commands by a chain": ["network.ca.law={kind='markov', matrix=[[0.3, 0.7], [0.6, 0.4]]}"],
    "commands get lost": [f"network.ca={{law={{kind='packet', loss=0.3, {UNIFORM}}}, max_age=1}}"],
}  # fmt: skip


def with_gains(which: str, *sets: str, uses: str = "history", cut: int | None = None) -> Loop:
    """multisensor-ours under random gains on every sample that comes."""
    free = load_experiment("multisensor-ours", ["duration=2", "allow_uncertified=true", *SETS[which], *sets])
    nodes = rig_of(free).nodes
    known = replace(nodes, delays=tuple(delay or 0 for delay in nodes.delays))
    mask = mask_of(known, cut or (3 if which == "late packets" else 5), uses)  # type: ignore[arg-type]
    gains = np.random.default_rng(1).normal(size=mask.shape) * mask
    table = f"controller={{kind='historical', uses='{uses}', gains={gains[:, :, None, :].tolist()}}}"
    free_of_limits = ["duration=2", "limits={watchdog_slots=1000}"]
    return compose(load_experiment("multisensor-ours", [*free_of_limits, *SETS[which], table, *sets]), certify=False)


def phases_of(loop: Loop) -> tuple[DelayedPlant, PhaseGains]:
    """The plant and the gains of every phase of the run, as the certificate takes them."""
    plant = delayed_plant_of(loop.experiment.plant, loop.model)
    found = history_of(loop.rig, loop.chains, loop.controller, loop.model)  # type: ignore[arg-type]
    assert plant is not None and isinstance(found, PhaseGains)
    return with_commands(plant, found)


def follow(loop: Loop, seeds: int, slots: int = 40) -> None:
    """Every run is a path of the chain: in each slot some phase that may follow has its state."""
    plant, each = phases_of(loop)
    past = np.vstack([loop.experiment.plant.initial_state, *loop.experiment.plant.initial_history])  # type: ignore[attr-defined]
    closed, first = run_from(plant, each.gains, past, each.transition, each.renewed, each.ages)
    states = [signal.name for signal in loop.experiment.plant.states]
    for seed in range(seeds):
        run = simulate(loop, seed).arrays["/plant/state"]
        may = {i: [first] for i in np.flatnonzero(each.start).tolist()}
        for k in range(slots):
            x, after = np.array([run[name][k] for name in states]), {}  # type: ignore[var-annotated]
            may = {i: [z for z in own if np.allclose(z[:4], x, rtol=2e-5, atol=3e-5)] for i, own in may.items()}
            assert any(may.values()), f"slot {k} of seed {seed}"
            for i, own in may.items():
                for z in own:
                    moved = closed.L[i] @ z
                    for j in np.flatnonzero(closed.transition[i]).tolist():
                        if not any(np.allclose(moved, other, atol=1e-9) for other in after.setdefault(j, [])):
                            after[j].append(moved)
            may = after


@pytest.mark.parametrize("which", SETS)
def test_a_run_is_a_path_of_the_phases_of_what_is_known(which: str) -> None:
    """Samples from before the window are held, and those that a newer packet made the controller forget act as 0."""
    follow(with_gains(which), 3)


@pytest.mark.parametrize(("which", "uses"), [("clocks and turns", "current-packet"), ("all late", "current-packet")])
def test_a_run_on_the_current_packet_is_a_path_of_its_phases(which: str, uses: str) -> None:
    follow(with_gains(which, *CLOCKS[:2], uses=uses), 2)


def test_a_history_that_is_short_holds_what_comes_late_and_is_newer_than_all() -> None:
    """Packets that are older than the controller's memory when they come replace what is held, and are forgotten otherwise."""
    follow(with_gains("late packets", "network.nodes.first.buffer=1", "network.sc.max_age=3", cut=2), 3)


@pytest.mark.parametrize("which", ["a bus that loses frames", "late packets", "commands get lost", "late by a chain"])
def test_the_means_of_many_runs_are_those_of_the_phases(which: str) -> None:
    loop, slots, runs = with_gains(which, "duration=0.4"), 8, 250
    plant, each = phases_of(loop)
    past = np.vstack([loop.experiment.plant.initial_state, *loop.experiment.plant.initial_history])  # type: ignore[attr-defined]
    closed, first = run_from(plant, each.gains, past, each.transition, each.renewed, each.ages)
    mean, said = each.start[:, None] * first, []
    for _ in range(slots):
        said.append(mean[:, :4].sum(axis=0))
        mean = closed.transition.T @ np.einsum("iab,ib->ia", closed.L, mean)
    seen = [simulate(loop, seed).arrays["/plant/state"] for seed in range(runs)]
    x = np.array([[run[f"x{i + 1}"][:slots] for i in range(4)] for run in seen]).transpose(0, 2, 1)
    away = np.abs(x.mean(axis=0) - said)
    assert np.all(away <= 4.5 * x.std(axis=0) / np.sqrt(runs) + 1e-4 * np.abs(x).max())


def test_second_moments_are_those_of_all_paths_of_the_controller_that_runs() -> None:
    """Seven slots, 128 paths, each with the controller's own memory of samples."""
    loss, A, B, slots = 0.4, np.array([[1.1, 0.3], [-0.2, 0.9]]), np.array([[0.5], [1.0]]), 7
    sets = [*PLANT, f"plant.A={A.tolist()}", f"plant.B={B.tolist()}", f"network.media.bus.loss={loss}"]
    sets.append("network.media.bus.phase=1")
    nodes = rig_of(load_experiment("multisensor-ours", ["allow_uncertified=true", *sets])).nodes
    K = np.random.default_rng(2).normal(size=(2, 3, 1, 2)) * mask_of(nodes, 2, "history")[:, :, None, :]
    table = f"controller={{kind='historical', gains={K.tolist()}}}"
    loop = compose(load_experiment("multisensor-ours", [*sets, table]), certify=False)
    plant, each = phases_of(loop)
    closed = close(plant, each.gains, each.transition, renewed=each.renewed)
    S = np.zeros_like(closed.L)
    S[:, 0, 0], S[:, 1, 1], S[:, 0, 1], S[:, 1, 0] = (each.start * v for v in (1.0, 4.0, -2.0, -2.0))
    said = [S[:, :2, :2].sum(axis=0)]
    for _ in range(slots):
        S = forward(closed.L, closed.transition, S)
        said.append(S[:, :2, :2].sum(axis=0))
    law: Historical = historical_of(K, "history")
    seen = np.zeros((slots + 1, 2, 2))
    for path in product((True, False), repeat=slots):
        share, x = float(np.prod([1.0 - loss if came else loss for came in path])), np.array([1.0, -2.0])
        running, assembly = law.start(loop.model), SampleHistory(loop.rig.sensors, 2)
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
    with pytest.raises(HilError, match="--spread: not over a history with gaps"):
        judge_historical(few, spread=True)


def test_what_is_not_known_is_said_with_its_number() -> None:
    gains = np.zeros((2, 12, 1, 2)).tolist()
    table = f"controller={{kind='historical', gains={gains}}}"
    with pytest.raises(HilError, match="media, clocks and laws together have more than 1024 states"):
        compose(load_experiment("multisensor-ours", [*PLANT, table, "network.media.bus.loss=0.1"]))
    few = f"controller.gains={np.zeros((5, 4, 1, 2)).tolist()}"
    many = f"plant.delayed={np.zeros((97, 2, 2)).tolist()}"
    with pytest.raises(HilError, match=r"what is known has 80 phases of 198 states: 3136320 numbers, at most 700000"):
        unstable(0.1, many, "network.media.bus.nodes=['first', 'second', 'first', 'second', 'first']", few)
    sojourn = "[{law='discrete-weibull', q=0.7, beta=0.8}, {law='geometric', p=0.5}]"
    commands = f"network.ca.law={{kind='semi-markov', matrix=[[0, 1], [1, 0]], sojourn={sojourn}}}"
    with pytest.raises(HilError, match=r"over network\.ca the tail of a sojourn law is known by bounds"):
        unstable(0.1, commands)
    with pytest.raises(HilError, match="over lost packets gains are designed for uses = 'current-packet' or 'last-packets'"):
        compose(load_experiment("multisensor-ours", ["network.media.bus.loss=0.1"]))


def test_clocks_decide_what_a_history_is_worth() -> None:
    """x1 grows by 1.2 in a slot: its sample of every second slot is enough, one of every eighth is not."""
    gains = "controller={kind='historical', gains=[[[[-0.6, 0.0]], [[-0.1, 0.0]]]]}"
    often, seldom = (
        compose(load_experiment("multisensor-ours", [
            *PLANT, gains, "network.media={}", f"network.nodes.first.clock={{every={every}}}", "allow_uncertified=true",
        ])).verdict
        for every in (2, 8)
    )  # fmt: skip
    assert often is not None and often.certified and often.details["phases"] == 3
    assert seldom is not None and seldom.state == "refused" and (seldom.number or 0.0) > 1.01


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
