"""Faults of a CAN bus with time: disturbed bits and nodes off the bus, as frames, error states and events."""

from __future__ import annotations

import re

import numpy as np
import pytest

from hil.compose import compose
from hil.errors import ExperimentError
from hil.experiment import load_experiment
from hil.log.read import Run
from hil.rig import rig_of
from hil.runtime.virtual import simulate
from hil.session import simulated_session

NAME, PERIOD_NS = "dc-motor-busy-can", 50_000_000
RECOVERY_NS = 128 * 11 * 8_000  # at 125 kbit/s


def run_with(*faults: str, duration: str = "2s", seed: int = 3) -> Run:
    e = load_experiment(NAME, [f"duration={duration}", f"fault=[{', '.join(faults)}]"])
    return simulate(compose(e, certify=False), seed)


def statuses(run: Run, node: str) -> list[tuple[int, str]]:
    """(instant in ns, what) of each change of a node's error state."""
    found = [e for e in run.events if e["kind"] == "bus status" and e["data"]["node"] == node]
    return [(e["data"]["at_ns"], re.sub(r".* is (.*): TEC.*", r"\1", e["message"])) for e in found]


def test_the_frames_of_one_identifier_are_destroyed_while_the_fault_lasts_and_end_their_sender() -> None:
    run = run_with("{at=0.5, for=0.5, kind='bit-errors', can_id=0x12}")
    bus = run.arrays["/link/bus"]
    own, begun = bus["can_id"] == 0x12, bus["start_ns"]
    during = (begun >= 500_000_000) & (begun < 1_000_000_000)
    destroyed = bus["error_bit"] >= 0
    np.testing.assert_array_equal(destroyed, own & during)  # every one of these, and no other
    assert int(destroyed.sum()) >= 32
    changes = [state for _, state in statuses(run, "SAE 2")]
    assert changes[:3] == ["above the warning level", "error passive", "off the bus"] and changes[3] == "error active"
    kinds = [e["kind"] for e in run.events]
    assert "fault: bit-errors" in kinds and "fault over: bit-errors" in kinds
    said = next(e["message"] for e in run.events if e["kind"] == "fault: bit-errors")
    assert said == "bit errors on the frames 0x12 of the CAN bus for 0.5 s"


def test_bits_are_disturbed_at_their_rate_while_the_fault_lasts_and_the_rest_of_the_run_is_as_without() -> None:
    rate, with_it, without = 2e-3, run_with("{at=0.5, for=1, kind='bit-errors', rate=2e-3}"), run_with()
    bus = with_it.arrays["/link/bus"]
    during = (bus["start_ns"] >= 500_000_000) & (bus["start_ns"] < 1_500_000_000)
    destroyed = bus["error_bit"] >= 0
    assert not np.any(destroyed & ~during)
    bits = (bus["idle_ns"] - bus["start_ns"])[during & ~destroyed] / 8_000 - 3
    whole = 1.0 - (1.0 - rate) ** bits.mean()
    share, count = destroyed[during].mean(), int(during.sum())
    assert abs(share - whole) < 5.0 * (whole * (1.0 - whole) / count) ** 0.5  # error rate 6e-7; twice the rate is seen
    before = without.arrays["/link/bus"]
    first = before[before["start_ns"] < 500_000_000]
    np.testing.assert_array_equal(bus[: len(first)], first)


def test_it_is_reproducible_from_the_seed() -> None:
    fault = "{at=0.5, for=1, kind='bit-errors', rate=1e-3}"
    a, b, c = (run_with(fault, seed=seed).arrays["/link/bus"] for seed in (3, 3, 4))
    np.testing.assert_array_equal(a, b)
    assert len(a) != len(c) or np.any(a["error_bit"] != c["error_bit"])


def test_a_node_off_the_bus_sends_nothing_and_comes_back_after_128_times_11_recessive_bits() -> None:
    run = run_with("{at=0.5, for=0.5, kind='bus-off', node='SAE 2'}")
    bus = run.arrays["/link/bus"]
    own = bus["start_ns"][bus["can_id"] == 0x12]
    changes = statuses(run, "SAE 2")
    assert changes[0] == (500_000_000, "off the bus") and changes[1][1] == "error active" and len(changes) == 2
    back = changes[1][0]
    assert back >= 1_000_000_000 + RECOVERY_NS
    assert not np.any((own > 500_000_000) & (own < back)) and np.any(own >= back)


def test_the_motor_off_the_bus_is_an_event_its_packets_are_lost_and_the_loop_goes_on() -> None:
    run = run_with("{at=0.5, for=0.2, kind='bus-off', node='motor'}")
    bus = run.arrays["/link/bus"]
    own = bus["start_ns"][bus["can_id"] == 0x100]
    assert not np.any((own > 500_000_000) & (own < 700_000_000)) and np.any(own > 800_000_000)
    assert [state for _, state in statuses(run, "motor")] == ["off the bus", "error active"]


def test_two_faults_that_overlap_keep_a_node_off_until_the_later_end() -> None:
    run = run_with("{at=0.5, for=0.5, kind='bus-off', node='SAE 2'}", "{at=0.6, for=0.8, kind='bus-off', node='SAE 2'}")
    changes = statuses(run, "SAE 2")
    assert len(changes) == 2 and changes[1][0] >= 1_400_000_000 + RECOVERY_NS


def test_without_a_second_node_nothing_is_acknowledged_and_the_sender_stays_on() -> None:
    names = [f"SAE {i}" for i in range(1, 18)] + ["controller", "actuator"]
    run = run_with(*(f"{{at=0.5, for=0.5, kind='bus-off', node='{name}'}}" for name in names), duration="1s")
    states = [state for _, state in statuses(run, "motor")]
    assert states == ["above the warning level", "error passive"]  # TEC stops at 128


def test_no_bound_is_said_of_a_bus_that_is_broken_for_a_while() -> None:
    changes = ["duration=1s", "fault=[{at=0.5, for=0.1, kind='bus-off', node='motor'}]"]
    summary = simulated_session(compose(load_experiment(NAME, changes), certify=False), 1).summary
    assert all(message["bound_ms"] is None for message in summary["network"]["bus"]["messages"])


@pytest.mark.parametrize(
    ("name", "fault", "says"),
    [
        (NAME, "{at=1, for=1, kind='bit-errors'}", "fault[0].rate: neither rate nor can_id is given; name one of them"),
        (NAME, "{at=1, for=1, kind='bit-errors', rate=0.1, can_id=1}", "fault[0].rate: both rate and can_id are given"),
        (NAME, "{at=1, for=1, kind='bit-errors', rate=1.5}", "fault[0].rate: 1.5, expected a probability above 0"),
        (NAME, "{at=1, for=1, kind='bit-errors', rate=0.1, node='motor'}", "fault[0].node: disturbed bits are seen by all nodes"),
        (NAME, "{at=1, for=1, kind='cut', node='motor', rate=0.1}", "fault[0].rate: only a fault of kind 'bit-errors' has one"),
        (NAME, "{at=1, for=1, kind='bit-errors', can_id=0x20000000}", "fault[0].can_id: 0x20000000, expected up to 29 bits"),
        (NAME, "{at=1, kind='bit-errors', rate=0.1}", "fault[0].for: missing"),
        (NAME, "{at=1, for=1, kind='cut', node='SAE 2'}", "fault[0].node: there is no node 'SAE 2'"),
        ("dc-motor-hinf", "{at=1, for=1, kind='bit-errors', rate=0.1}", "fault[0].kind: there is no CAN bus with time"),
    ],
)
def test_a_fault_that_cannot_be_is_refused_with_its_path(name: str, fault: str, says: str) -> None:
    with pytest.raises(ExperimentError, match=re.escape(says)):
        rig_of(load_experiment(name, [f"fault=[{fault}]"]))
