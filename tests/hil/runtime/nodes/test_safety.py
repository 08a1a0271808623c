"""Safety at the rig: limits, watchdog, latch; and what the passivity controller observes, injects, and leaves alone."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.compose import compose
from hil.errors import ExperimentError
from hil.experiment import load_experiment
from hil.runtime.nodes.safety import PortDamper, Safety
from hil.runtime.virtual import simulate
from hil.session import run_session
from hil.session.replay.replay import verify
from plants import Signal


@pytest.mark.parametrize("value", [2.1, -2.1, math.nan, math.inf, -math.inf])
def test_state_beyond_its_bound_or_not_finite_trips(value: float) -> None:
    safety = Safety(None, [(1, Signal("speed", "m/s"), 2.0)], 3)
    assert safety.check_state((0.0, 2.0)) is None
    assert safety.check_state((0.0, value)) == f"speed = {value:.4g} m/s is beyond its limit 2 m/s"
    assert safety.tripped


def test_unlimited_state_that_is_not_finite_trips_too() -> None:
    assert Safety(None, [], 3).check_state((math.nan,)) == "the plant's state is not finite"


def test_a_command_beyond_its_bound_is_reported_with_name_and_unit_of_its_input() -> None:
    safety = Safety((1.0, 5.0), [], 3, 0, (Signal("flow", "1"), Signal("voltage", "V")))
    assert safety.check_command((0.5, -5.2)) == "command voltage = -5.2 V is beyond its limit 5 V"


def test_a_command_of_a_pure_number_has_no_unit() -> None:
    assert Safety((1.0,), [], 3, 0, (Signal("flow", "1"),)).check_command((1.5,)) == "command flow = 1.5 is beyond its limit 1"


def test_command_beyond_its_bound_trips_once_and_stays_tripped() -> None:
    safety = Safety((1.0,), [], 3, 0, (Signal("voltage", "V"),))
    assert safety.check_command((1.0,)) is None
    assert safety.check_command((1.01,)) is not None
    assert safety.check_command((0.0,)) is None  # said once
    assert safety.tripped is not None and "1.01" in safety.tripped


def test_watchdog_counts_slots_in_a_row_only() -> None:
    safety = Safety(None, [], 3)
    for _ in range(10):
        assert safety.starved() is None
        assert safety.starved() is None
        assert safety.check_command((0.0,)) is None
    assert [safety.starved() is not None for _ in range(4)] == [False, False, True, False]


def test_the_watchdog_trips_by_the_clock_where_slots_take_longer() -> None:
    """200 slots of 1 ms are 200 ms, also where a slot takes 4 ms; in nominal time nothing changes."""
    ms = 1_000_000
    slow, nominal = Safety(None, [], 200, ms), Safety(None, [], 200, ms)
    tripped = [k for k in range(200) if slow.starved(4 * k * ms)]
    assert tripped == [50] and "ms (51 slots) without a usable command" in str(slow.tripped)  # 199 ms after the first
    assert [k for k in range(300) if nominal.starved(k * ms)] == [199] and "200 slots in a row" in str(nominal.tripped)
    fed = Safety(None, [], 200, ms)
    assert not any(fed.starved(4 * k * ms) or (k % 40 == 0 and fed.check_command((0.0,))) for k in range(400))


LET = "allow_uncertified=true"


def limits(passivity: str, state: str = "position = 0.5") -> str:
    return f"limits={{input = [20.0], state = {{{state}}}, passivity = {{{passivity}}}}}"


def damper(**change: Any) -> PortDamper:
    given = {"period_s": 0.1, "credit": 2.0, "largest": 30.0, "allowed_j": 0.0, "trip_j": None, "limit": 5.0}
    return PortDamper(**{**given, **change})


def test_the_observed_energy_is_force_times_way_less_what_damping_takes() -> None:
    port, total, x = damper(), 0.0, 0.0
    port.observe(x, 99.0)  # nothing has moved yet
    for force, moved in ((1.0, 0.01), (-2.0, 0.02), (3.0, -0.005)):
        x += moved
        port.observe(x, force)
        total += force * moved - 2.0 * moved**2 / 0.1
    assert port.energy_j == pytest.approx(total, rel=1e-12)


def test_it_injects_just_what_takes_the_energy_back_and_never_more_than_it_may() -> None:
    port = damper()
    port.observe(0.0, 0.0)
    port.observe(0.01, 1.0)  # given: 0.01 - 2 * 0.1 * 0.01 = 0.008 J at 0.1 m/s
    put_out, injected = port.damp(1.0)
    assert injected.damping == pytest.approx(0.008 / (0.1 * 0.1**2))
    assert injected.force * 0.1 * 0.1 == pytest.approx(-0.008)  # over a slot at that speed
    assert put_out == 1.0 + injected.force
    bounded = damper(largest=3.0)
    bounded.observe(0.0, 0.0)
    bounded.observe(0.01, 1.0)
    assert bounded.damp(1.0)[1].damping == 3.0


def test_command_and_damping_together_stay_within_the_limit_of_the_force() -> None:
    port = damper(limit=1.05)
    port.observe(0.0, 0.0)
    port.observe(0.01, 1.0)
    put_out, injected = port.damp(-1.0)
    assert put_out == -1.05 and injected.force == pytest.approx(-0.05) and injected.damping == pytest.approx(0.5)


def test_without_speed_or_energy_the_command_stays_as_it_is() -> None:
    port = damper()
    port.observe(0.0, 0.0)
    port.observe(-0.01, 1.0)  # the hand pressed: the motor took energy
    assert port.damp(0.7) == (0.7, (port.energy_j, 0.0, 0.0)) and port.energy_j < 0.0
    port.observe(0.02, 2.0)
    assert port.energy_j > 0.0
    port.observe(0.02, 2.0)
    assert port.damp(0.7)[0] == 0.7


def test_a_damper_bounds_the_coupler_of_theorem_61_that_diverges_without() -> None:
    """The motion stays; the device comes to rest where T/(2 b) and the wall say: 13.59 mm."""
    held = simulate(compose(load_experiment("omni-theorem61", [LET, limits("damping_n_s_per_m = 30")])), 0)
    x, put_out = held.arrays["/plant/state"]["position"], held.arrays["/actuator/applied"]["force"]
    assert len(x) == 800 and not any(event["kind"] == "safety" for event in held.events)
    assert np.abs(x).max() < 0.17 and np.ptp(x[-100:]) < 1e-9
    assert x[-1] == pytest.approx(0.001 + 0.05 / (2 * 1.9857), abs=1e-6)
    seen = held.arrays["/actuator/passivity"]
    assert seen["damping"].max() == 30.0 and seen["energy"].max() > 0.1
    rows = held.arrays["/controller/rows"]["row0_force"]
    applied = held.arrays["/actuator/applied"]
    np.testing.assert_array_equal(put_out[8:], (rows[applied["packet_slot"][8:]] + seen["force"][8:]))
    free = simulate(compose(load_experiment("omni-theorem61", [LET, "limits={state={position=5.0}}"])), 0)
    assert np.abs(free.arrays["/plant/state"]["position"]).max() > 2.0


@pytest.mark.parametrize("name", ["omni-push", "omni-wifi"])
def test_behind_a_certified_coupler_it_never_acts_and_changes_no_bit(name: str) -> None:
    without, with_it = (
        simulate(compose(load_experiment(name, sets, duration="10 s")), 3)
        for sets in ([], [limits("damping_n_s_per_m = 30, energy_j = 1e-9, trip_j = 1e-6", "given = 0.01")])
    )
    for topic in ("/plant/state", "/plant/measurement", "/actuator/applied", "/controller/rows", "/link/control"):
        a, b = without.arrays[topic], with_it.arrays[topic]
        for field in a.dtype.names or ():
            assert a[field].tolist() == b[field].tolist() or np.array_equal(a[field], b[field], equal_nan=True)
    assert not with_it.arrays["/actuator/passivity"]["force"].any()


def test_it_trips_on_energy_long_before_the_motion_has_grown(tmp_path: Path) -> None:
    tripped = run_session(load_experiment("omni-theorem61", [LET, limits("trip_j = 0.01")]), path=tmp_path / "a.mcap")
    moved = run_session(load_experiment("omni-theorem61", [LET, limits("trip_j = 1e9")]), path=tmp_path / "b.mcap")
    assert tripped.status == moved.status == 3
    assert "passivity: the motor has given" in tripped.summary["safety"] and "limit 0.01 J" in tripped.summary["safety"]
    assert "position" in moved.summary["safety"] and tripped.summary["slots"] < moved.summary["slots"]
    state = tripped.arrays["/plant/state"]
    at = int(np.flatnonzero(tripped.arrays["/actuator/applied"]["status"] == 3)[0])
    assert state["given"][at - 1] <= 0.01 < state["given"][at]  # the slot in which it was observed
    assert not tripped.arrays["/actuator/applied"]["force"][at:].any()


def test_a_damped_run_is_repeated_bit_for_bit_from_its_log(tmp_path: Path) -> None:
    asked = load_experiment("omni-theorem61", [LET, limits("damping_n_s_per_m = 30")], duration="5 s")
    done = run_session(asked, path=tmp_path / "a.mcap")
    assert done.arrays["/actuator/passivity"]["force"].any()
    assert verify(done.run).difference is None


def test_what_is_not_certified_without_it_is_undecided_with_it() -> None:
    with pytest.raises(ExperimentError, match=r"undecided: refused without the passivity controller .*spectral radius 1\.1527"):
        compose(load_experiment("omni-theorem61", [limits("damping_n_s_per_m = 30")]))
    verdicts = [compose(load_experiment("omni-push", sets)).verdict for sets in ([], [limits("damping_n_s_per_m = 30")])]
    assert all(v is not None and v.certified for v in verdicts)
    assert verdicts[0].digest != verdicts[1].digest  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("passivity", "message"),
    [
        ("damping_n_s_per_m = -1", r"limits\.passivity\.damping_n_s_per_m: -1 is negative"),
        ("energy_j = 0.1", r"limits\.passivity\.damping_n_s_per_m: the passivity controller neither damps nor trips"),
        ("damping_n_s_per_m = 3, energy_j = -0.1", r"limits\.passivity\.energy_j: -0\.1 is negative"),
        ("trip_j = 0.0", r"limits\.passivity\.trip_j: 0 is not positive"),
        ("damper = 3", r"limits\.passivity\.damper: unknown field"),
    ],
)
def test_a_passivity_controller_that_cannot_be_is_refused_with_its_place(passivity: str, message: str) -> None:
    with pytest.raises(ExperimentError, match=message):
        load_experiment("omni-push", [limits(passivity)])


def test_a_plant_without_a_port_has_no_passivity_controller() -> None:
    with pytest.raises(ExperimentError, match=r"limits\.passivity: needs a passive device .* takes voltage in V"):
        compose(load_experiment("dc-motor-hinf", ["limits.passivity={damping_n_s_per_m=1}"]))
