"""The cycle of a bus with arbitration: what the theory takes is what the rig does."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from hil.compose import compose
from hil.errors import HilError
from hil.experiment import load_experiment
from hil.experiment.nodes import ClockTable
from hil.measure.cost import Cost
from hil.measure.summary import summarise
from hil.measure.view import view_of
from hil.pages import Figure
from hil.pages.sections.traffic import sensor_nodes
from hil.rig.loop import Loop
from hil.rig.slotted_media import bus_cycle
from hil.runtime.virtual import simulate
from hil.session import run_session
from hil.session.replay.replay import verify
from tests.transport.medium.test_scheduled import bus, received
from transport.errors import NotKnown
from transport.medium import SampleClock

ONE = "controller={kind='historical', gains=[[[[0.0, 0.0, -2.0, 0.0]]]]}"
NAMES = ("first", "second", "third", "fourth")


def on_a_bus(clocks: str, *sets: str, frames: int = 1, loss: float = 0.0) -> Loop:
    """multisensor-ours with the clocks of its nodes, such as "4+0 4+1 8+2 8+3", and packets of one sample."""
    medium = f"network.media={{bus={{kind='can-arbitration', nodes={list(NAMES)}, frames={frames}, loss={loss}}}}}"
    stated = [c.split("+") for c in clocks.split()]
    own = [f"network.nodes.{name}.clock={{every={every}, phase={phase}}}" for name, (every, phase) in zip(NAMES, stated)]
    buffers = [f"network.nodes.{name}.buffer=1" for name in NAMES]
    return compose(load_experiment("multisensor-ours", [medium, *own, *buffers, *sets]))


def test_a_cycle_names_which_node_is_received_and_how_old_its_sample_is() -> None:
    assert bus_cycle([ClockTable(every=4)] * 4, 1) == (((0, 0),), ((1, 1),), ((2, 2),), ((3, 3),))
    assert bus_cycle([ClockTable(every=4)] * 4, 2) == (((0, 0), (1, 0)), ((2, 1), (3, 1)), (), ())
    assert bus_cycle([ClockTable()] * 2, 1) == (((0, 0),),)


def test_the_cycle_is_what_a_literal_bus_carries() -> None:
    rng = np.random.default_rng(2)
    cycles = 0
    for _ in range(60):
        every = rng.choice([1, 2, 3, 4, 6], size=3)
        clocks = [ClockTable(every=int(n), phase=int(rng.integers(n))) for n in every]
        frames = int(rng.integers(1, 3))
        try:
            cycle = bus_cycle(clocks, frames)
        except NotKnown:
            continue
        running = [SampleClock(every=clock.every, phase=clock.phase) for clock in clocks]
        offers = {k: [n for n, clock in enumerate(running) if clock.due(k)] for k in range(40)}
        for k, came in enumerate(received(bus(3, frames=frames), offers, 40)):
            assert came == [(n, k - age) for n, age in cycle[k % len(cycle)] if age <= k]
        cycles += 1
    assert cycles > 40


@pytest.mark.parametrize(
    ("clocks", "says"),
    [
        ([ClockTable(every=4, jitter=1)] * 2, "clocks that draw: nodes [0, 1]"),
        ([ClockTable(every=4), ClockTable(every=4, random_phase=True)], "clocks that draw: nodes [1]"),
        ([ClockTable(every=9), ClockTable(every=8)], "every 72 slots, the theory takes cycles of 64"),
    ],
)
def test_why_there_is_no_cycle(clocks: list[ClockTable], says: str) -> None:
    with pytest.raises(NotKnown, match=re.escape(says)):
        bus_cycle(clocks, 1)


@pytest.mark.parametrize(
    ("clocks", "frames", "sets"),
    [("4+0 4+0 4+0 4+0", 1, ()), ("3+2 2+0 3+1 6+5", 1, ("network.sc.law.age=1",)), ("1+0 2+0 4+1 4+3", 2, ())],
)
def test_gains_for_a_bus_cost_what_their_certificate_says(clocks: str, frames: int, sets: tuple[str, ...]) -> None:
    loop = on_a_bus(clocks, "controller.memory=6", *sets, frames=frames)
    assert loop.verdict is not None and loop.verdict.certified
    found = Cost().of(view_of(simulate(loop, 0), loop.experiment))["cost"]
    assert found == pytest.approx(loop.verdict.details["cost"], rel=1e-5)


def test_the_lowest_can_identifier_wins_in_the_rig_and_in_the_theory() -> None:
    """Without can_id the first node sends in every slot and the second never; with these identifiers the other way."""
    ids = ("network.nodes.first.can_id=0x12", "network.nodes.second.can_id=0x11")
    sets = (*ids, "controller.memory=6", "duration=1", "allow_uncertified=true")
    loop = on_a_bus("1+0 1+0 4+0 4+0", *sets)
    nodes = summarise(view_of(simulate(loop, 0), loop.experiment))["network"]["nodes"]
    assert [nodes[name]["packets"] for name in NAMES] == [0, 20, 0, 0]
    assert loop.model.sensors is not None and loop.model.sensors.turns is not None
    assert loop.model.sensors.turns.received == (((1, 0),),) * 4
    mixed = on_a_bus("4+0 4+0 4+0 4+0", "network.nodes.third.can_id=0x9", "controller.memory=6")
    assert mixed.verdict is not None and mixed.verdict.certified
    found = Cost().of(view_of(simulate(mixed, 0), mixed.experiment))["cost"]
    assert found == pytest.approx(mixed.verdict.details["cost"], rel=1e-5)
    assert mixed.model.sensors is not None and mixed.model.sensors.turns is not None
    assert mixed.model.sensors.turns.received == (((2, 0),), ((0, 1),), ((1, 2),), ((3, 3),))


def test_the_log_of_a_run_over_a_bus_is_made_again_bit_for_bit(tmp_path: Path) -> None:
    loop = on_a_bus("2+0 3+1 4+0 4+0", ONE, "allow_uncertified=true",
                    "network.nodes.first.clock.jitter=1", "duration=1", loss=0.2)
    result = run_session(loop.experiment, path=tmp_path / "a.mcap")
    assert result.status == 0 and verify(result.run).difference is None


def test_the_report_shows_the_slot_in_which_a_node_spoke_and_the_summary_what_was_replaced() -> None:
    loop = on_a_bus("4+0 1+0 4+0 4+0", "controller.memory=6", "duration=1", "allow_uncertified=true")
    view = view_of(simulate(loop, 0), loop.experiment)
    page = sensor_nodes(view)
    assert page is not None
    spoke, ages, _ = page.blocks
    assert isinstance(spoke, Figure) and isinstance(ages, Figure)
    np.testing.assert_allclose(spoke.series[0].x, 0.05 * np.arange(20))
    assert spoke.series[0].y[:6].tolist() == [0, 1, 1, 1, 0, 1]
    assert ages.series[0].y[:9].tolist() == [0, 1, 2, 3, 0, 1, 2, 3, 0] and np.isnan(ages.series[2].y).all()
    nodes = summarise(view)["network"]["nodes"]
    assert [nodes[name]["packets"] for name in NAMES] == [5, 15, 0, 0]
    assert nodes["second"]["fates"]["replaced"] == 5 and nodes["third"]["fates"]["replaced"] == 4


def test_a_clock_of_a_random_phase_has_a_state_for_each() -> None:
    loop = on_a_bus("4+0 4+0 4+0 4+0", ONE, "network.nodes.first.clock.random_phase=true", "allow_uncertified=true")
    assert loop.verdict is not None and loop.verdict.details["phases"] >= 4 * 4  # type: ignore[operator]


def test_a_bus_whose_clocks_draw_is_decided_and_its_runs_differ_by_their_seed() -> None:
    loop = on_a_bus("4+0 4+0 4+0 4+0", ONE, "allow_uncertified=true", "network.nodes.first.clock.jitter=3", "duration=2")
    assert loop.verdict is not None and loop.verdict.state in ("certified", "refused")
    first, again, other = (simulate(loop, seed).arrays["/link/sensor"]["data"].tolist() for seed in (0, 0, 1))
    assert first == again != other
    with pytest.raises(HilError, match="clocks that draw"):
        on_a_bus("4+0 4+0 4+0 4+0", "network.nodes.first.clock.jitter=3")
    none = f"controller={{kind='historical', gains={4 * [[[4 * [0.0]]]]}}}"
    lossy = on_a_bus("4+0 4+0 4+0 4+0", none, "allow_uncertified=true", loss=0.1)
    assert lossy.verdict is not None and lossy.verdict.details["cost"] == pytest.approx(225.519, abs=1e-3)


@pytest.mark.parametrize(
    ("sets", "says"),
    [
        (["network.nodes.first.clock.every=0"], "network.nodes.first.clock.every: 0 slots, expected 1 to 1000000"),
        (["network.nodes.first.clock={every=4, phase=4}"], "network.nodes.first.clock.phase: 4, expected 0 to every - 1 = 3"),
        (["network.nodes.first.clock={every=4, jitter=4}"],
         "network.nodes.first.clock.jitter: 4 slots, expected 0 to every - 1 = 3"),
        (["network.nodes.first.clock={every=4, phase=1, random_phase=true}"],
         "network.nodes.first.clock.phase: random_phase draws it"),
        (["network.media.bus.frames=2"], "network.media.bus.frames: for a can-arbitration medium only"),
        (["network.media.bus.kind='can-arbitration'", "network.media.bus.phase=0", "network.media.bus.frames=0"],
         "network.media.bus.frames: 0 in a slot"),
        (["network.media.bus.kind='can-arbitration'"], "network.media.bus.phase: for a round-robin medium only"),
        (["network.media.bus.kind='can-arbitration'", "network.media.bus.phase=0",
         "network.media.bus.nodes=['first', 'first']"], "is named twice"),
        (["network.media.bus.kind='can-arbitration'", "network.media.bus.phase=0", "controller.uses='newest'"],
         "controller.uses: where several"),
    ],
)
def test_a_fault_of_a_bus_or_a_clock_is_refused_with_its_place(sets: list[str], says: str) -> None:
    with pytest.raises(HilError) as caught:
        compose(load_experiment("multisensor-ours", sets))
    assert says in str(caught.value)


@pytest.mark.parametrize("node", ["", "network.nodes={angle={outputs=['angle'], buffer=1}}"])
def test_samples_that_no_node_sends_are_refused_before_gains_are_solved(node: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hil.compose.stored_gains.solve", lambda *_: pytest.fail("gains are solved"))
    name = "dc-motor-ours-memory" if node else "dc-motor-two-nodes"
    with pytest.raises(HilError, match=r": controller\.samples: 2 in one packet, but no node alone sends so many samples"):
        compose(load_experiment(name, ["controller={kind='designed', samples=2}", *filter(None, [node])]))
