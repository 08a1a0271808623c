"""The ages that a CAN bus makes: those of every run are among those of the chain, and what prevents a chain is named."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from hil.compose import compose
from hil.experiment import load_experiment
from hil.log.topics import APPLIED, ROWS, SC
from hil.rig import rig_of
from hil.rig.bus_delays import bus_chains, bus_delays, chain_of_ages
from hil.rig.can_bus import can_bus_of
from hil.rig.loop_chains import loop_chains
from hil.runtime.virtual import simulate
from transport.errors import NotKnown

NAME = "dc-motor-busy-can"
TWO = '{name="a", can_id=1, data="0102", period="10 ms"}, {name="b", can_id=2, length=0, period="25 ms"}'
FIXED = f"network.media.bus.traffic=[{TWO}]"
SHAKEN = 'network.media.bus.traffic=[{name="a", can_id=1, period="5 ms", jitter="3 ms"}, {name="b", can_id=2, period="10 ms"}]'
OFTEN = '{name="a", can_id=1, period="10.000019 ms"}, {name="b", can_id=2, period="9.999991 ms"}'

NODES = (
    "plant.tachometer=true", "controller={kind='local-designed'}", "reference=[]", "disturbance=[]",
    'network.media.bus.nodes=["motor", "speed"]',
    "network.sc.max_age=4", "network.ca.max_age=2",
)  # fmt: skip


def rig(*sets: str):  # type: ignore[no-untyped-def]
    return rig_of(load_experiment(NAME, sets))


def steps(chain) -> set[tuple[int, int]]:  # type: ignore[no-untyped-def]
    """Pairs of ages that follow each other."""
    return {(int(chain.delay[i]), int(chain.delay[j])) for i, j in np.argwhere(chain.bounds[1] > 0.0)}


def test_the_busy_bus_leaves_open_what_the_length_of_its_frames_decides() -> None:
    own = rig()
    found = bus_delays(own, can_bus_of(own), 1)
    assert not found.exact
    assert found.packets[0] == ((1, 1), *((0, 0), (0, 1)) * 9, (0, 0)) and set(found.packets[1]) == {(0, 0)}
    assert found.worst_ns[1] <= 39_656_000 <= 40_000_000  # the bound of any offsets; the deadline leaves 40 ms
    chain = chain_of_ages(found.packets[0], own.at_controller)
    assert chain.open and chain.modes == 29 and steps(chain) == {(0, 0), (0, 1), (1, 0)}
    longest = bus_delays(own, can_bus_of(own), 1, longest=True)
    assert longest.exact
    design = chain_of_ages(longest.packets[0], own.at_controller)
    assert not design.open and design.delay.tolist() == [1, 0] and design.matrix.tolist() == [[0.0, 1.0], [1.0, 0.0]]


@pytest.mark.parametrize(
    "sets",
    [
        (), ("network.media.bus.bitrate=250000",), (FIXED, "network.media.bus.bitrate=20000"),
        ('period="20 ms"', "network.media.bus.bitrate=250000"), (SHAKEN,), (SHAKEN, "timing.deadline=0.03"),
    ],
)  # fmt: skip
def test_the_ages_of_a_run_follow_each_other_as_the_chain_says(sets: tuple[str, ...]) -> None:
    experiment = load_experiment(NAME, ("duration=4", "allow_uncertified=true", *sets))
    loop = compose(experiment, certify=False)
    found = bus_chains(loop.rig, loop.rows)
    run = simulate(loop, 3).arrays
    for ages, chain in ((run[ROWS.name]["tau"], found[0]), (run[APPLIED.name]["d"], found[1])):
        assert set(pairwise(ages[20:].tolist())) <= steps(chain)


def two_nodes(clock: str = "{every=2, phase=1}", *sets: str):  # type: ignore[no-untyped-def]
    return load_experiment(NAME, (f"network.nodes.speed={{outputs=['speed'], clock={clock}}}", *NODES, *sets))


@pytest.mark.parametrize(
    ("clock", "sets", "possible"),
    [
        ("{every=2, phase=1}", (), {(0, 0), (0, 1), (1, 1)}),
        ("{every=3}", ("network.media.bus.buffer='fifo'", "timing.deadline=0.1", SHAKEN), {(0, 0), (0, 1), (0, 2)}),
        ("{every=1}", (FIXED, "network.media.bus.bitrate=20000", "timing.deadline=0.3"), {(0, 0), (0, 1)}),
        ("{every=1}", (FIXED, "network.media.bus.bitrate=16000", "network.media.bus.buffer='fifo'"), {(1, 1)}),
        ("{every=2}", ("timing.deadline=0.3",), {(0, 0), (0, 1), (0, 2), (1, 0), (1, 2)}),
    ],
)  # fmt: skip
def test_the_ages_of_two_nodes_follow_each_other_as_their_chain_says(
    clock: str, sets: tuple[str, ...], possible: set[tuple[int, int]]
) -> None:
    """By hand: of all packets that have come the newest of each node, slot by slot; a path of the chain leads through them."""
    loop = compose(two_nodes(clock, "duration=4", "allow_uncertified=true", *sets), certify=False)
    chain = bus_chains(loop.rig, loop.rows)[0]
    assert {*map(tuple, chain.ages.tolist())} == possible
    came = simulate(loop, 3).arrays[SC.name]
    newest = np.zeros((80, 2), dtype=np.int64)
    for slot, sent, node in came[["slot", "packet_slot", "node"]][came["reason"] == 0].tolist():
        newest[slot:, node] = np.maximum(newest[slot:, node], sent)
    ages = np.arange(80)[:, None] - newest
    at = (chain.ages == ages[20]).all(axis=1)
    for own in ages[21:]:
        at = (chain.bounds[1][at] > 0.0).any(axis=0) & (chain.ages == own).all(axis=1)
        assert at.any()


def test_two_nodes_on_a_bus_are_certified_by_the_ages_of_both() -> None:
    verdict = compose(two_nodes()).verdict
    assert verdict is not None and verdict.certified and "over ages 0 to 1 at the controller" in verdict.reason
    table = "controller={kind='send-all', ages=[2, 2], selection='constant', gains=[[[[-0.1, -0.01]]], [[[%s]]], %s, %s]}"
    for gains, state in (("-0.1, -0.01", "certified"), ("9, 9", "refused")):  # in every other slot the speed is one slot old
        own = table % (gains, [[[0, 0]]], [[[0, 0]]])
        verdict = compose(two_nodes("{every=2}", FIXED, own, "allow_uncertified=true")).verdict
        assert verdict is not None and verdict.state == state


def test_frames_of_known_length_make_the_ages_repeat_exactly() -> None:
    own = rig(FIXED, "network.media.bus.bitrate=50000")
    sc, ca = bus_chains(own, 1)
    assert not sc.open and not ca.open and sc.between is None


def test_offsets_that_never_come_again_leave_the_bounds_of_any_offsets() -> None:
    own = rig(f"network.media.bus.traffic=[{OFTEN}]")
    found = bus_delays(own, can_bus_of(own), 1)
    assert found.packets == (((0, 0),), ((0, 0),)) and found.worst_ns == (3_656_000, 3_656_000)


@pytest.mark.parametrize(
    ("sets", "said"),
    [
        (("network.media.bus.bit_error_rate=1e-6",), "network.media.bus.bit_error_rate: disturbed frames are sent again"),
        (('network.media.bus.recorded=["1 123#11"]',), "frames of a recording have no period"),
        (("network.nodes.motor.clock.every=2", "network.nodes.motor.clock.jitter=1"), "network.nodes.motor.clock draws"),
        (('network.nodes.motor.trigger={kind="dead-band", threshold=0.1}',), "network.media.bus: the ages over a CAN bus"),
        (("network.media.bus.bitrate=100000",), "the messages may need more than the whole bus"),
        (('network.sc.law={kind="constant", age=1}',), "adds ages of its own"),
        (("network.nodes.speed.outputs=['speed']", *NODES, 'network.media.bus.nodes=["motor"]'), "node 'speed' is not on it"),
    ],
)
def test_what_prevents_a_chain_is_named_in_the_verdict(sets: tuple[str, ...], said: str) -> None:
    verdict = compose(load_experiment(NAME, ("allow_uncertified=true", *sets))).verdict
    assert verdict is not None and verdict.state == "undecided" and said in verdict.reason


@pytest.mark.parametrize(("period", "slots"), [("409.6 ms", 1024), ("400.390625 ms", 1025)])
def test_a_cycle_is_computed_up_to_1024_slots(period: str, slots: int) -> None:
    own = rig(f'network.media.bus.traffic=[{{name="a", can_id=1, period="{period}"}}]')
    if slots == 1024:
        assert len(bus_delays(own, can_bus_of(own), 1).packets[0]) == 1024
        return
    with pytest.raises(NotKnown, match="its traffic comes again after 1025 slots, at most 1024 are computed"):
        bus_delays(own, can_bus_of(own), 1)


def test_ages_grow_from_slot_to_slot_of_a_cycle_until_its_packet_comes() -> None:
    """One packet in three slots, in time or one slot late: backwards the same ages would fall."""
    at = rig().at_controller._replace(max_age=5)
    assert steps(chain_of_ages(((0, 0), None, None), at)) == {(0, 1), (1, 2), (2, 0)}
    assert steps(chain_of_ages(((1, 1), None, None), at)) == {(1, 2), (2, 3), (3, 1)}
    assert steps(chain_of_ages(((0, 1), None, None), at)) == {(0, 1), (1, 2), (2, 0), (2, 3), (3, 1)}


@pytest.mark.parametrize(("matrix", "begins"), [([[0.5, 0.5], [0.5, 0.5]], None), ([[0, 1], [1, 0]], [True, False])])
def test_beside_a_bus_a_law_may_be_in_any_mode_unless_it_repeats_as_the_bus_does(matrix: object, begins: object) -> None:
    law = f'network.ca.law={{kind="markov", matrix={matrix}, initial=[1, 0]}}'
    loop = compose(load_experiment(NAME, ("network.media.bus.control=false", law)), certify=False)
    ca = loop_chains(loop.rig, loop.chains, loop.controller, loop.model).ca
    assert ca is not None and (ca.begins if ca.begins is None else ca.begins.tolist()) == begins
