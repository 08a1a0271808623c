"""The ages that a CAN bus makes: those of every run are among those of the chain, and what prevents a chain is named."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from hil.compose import compose
from hil.experiment import load_experiment
from hil.log.topics import APPLIED, ROWS
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


def rig(*sets: str):  # type: ignore[no-untyped-def]
    return rig_of(load_experiment(NAME, sets))


def steps(chain) -> set[tuple[int, int]]:  # type: ignore[no-untyped-def]
    """Pairs of ages that follow each other."""
    return {(int(chain.delay[i]), int(chain.delay[j])) for i, j in np.argwhere(chain.bounds[1] > 0.0)}


def test_the_busy_bus_leaves_open_what_the_length_of_its_frames_decides() -> None:
    own = rig()
    found = bus_delays(own, can_bus_of(own), 1)
    assert not found.exact
    assert found.sensor == ((1, 1), *((0, 0), (0, 1)) * 9, (0, 0)) and set(found.control) == {(0, 0)}
    assert found.worst_ns[1] <= 39_656_000 <= 40_000_000  # the bound of any offsets; the deadline leaves 40 ms
    chain = chain_of_ages(found.sensor, own.at_controller)
    assert chain.open and chain.modes == 29 and steps(chain) == {(0, 0), (0, 1), (1, 0)}
    longest = bus_delays(own, can_bus_of(own), 1, longest=True)
    assert longest.exact
    design = chain_of_ages(longest.sensor, own.at_controller)
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


def test_frames_of_known_length_make_the_ages_repeat_exactly() -> None:
    own = rig(FIXED, "network.media.bus.bitrate=50000")
    sc, ca = bus_chains(own, 1)
    assert not sc.open and not ca.open and sc.between is None


def test_offsets_that_never_come_again_leave_the_bounds_of_any_offsets() -> None:
    own = rig(f"network.media.bus.traffic=[{OFTEN}]")
    found = bus_delays(own, can_bus_of(own), 1)
    assert len(found.sensor) == 1
    assert found.sensor == ((0, 0),) and found.control == ((0, 0),) and found.worst_ns == (3_656_000, 3_656_000)


@pytest.mark.parametrize(
    ("sets", "said"),
    [
        (("network.media.bus.bit_error_rate=1e-6",), "network.media.bus.bit_error_rate: disturbed frames are sent again"),
        (('network.media.bus.recorded=["1 123#11"]',), "frames of a recording have no period"),
        (("network.nodes.motor.clock.every=2", "network.nodes.motor.clock.jitter=1"), "network.nodes.motor.clock draws"),
        (('network.nodes.motor.trigger={kind="dead-band", threshold=0.1}',), "network.media.bus: the ages over a CAN bus"),
        (("network.media.bus.bitrate=100000",), "the messages may need more than the whole bus"),
        (('network.sc.law={kind="constant", age=1}',), "adds ages of its own"),
    ],
)
def test_what_prevents_a_chain_is_named_in_the_verdict(sets: tuple[str, ...], said: str) -> None:
    verdict = compose(load_experiment(NAME, ("allow_uncertified=true", *sets))).verdict
    assert verdict is not None and verdict.state == "undecided" and said in verdict.reason


@pytest.mark.parametrize(("period", "slots"), [("409.6 ms", 1024), ("400.390625 ms", 1025)])
def test_a_cycle_is_computed_up_to_1024_slots(period: str, slots: int) -> None:
    own = rig(f'network.media.bus.traffic=[{{name="a", can_id=1, period="{period}"}}]')
    if slots == 1024:
        assert len(bus_delays(own, can_bus_of(own), 1).sensor) == 1024
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
