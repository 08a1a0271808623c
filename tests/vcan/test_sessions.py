"""Whole sessions over a real vcan0: the rig's and the controller's process, classic and FD frames, a link that is cut.

In virtual time nothing is late, so every session can be held to the one-process run bit for bit.
"""

from __future__ import annotations

import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import can
import numpy as np
import pytest

from hil.compose import compose
from hil.experiment import load_experiment
from hil.log.read import Run
from hil.runtime.virtual import simulate
from hil.session import Session, run_session
from hil.session.replay.replay import verify
from transport.links.can_identifiers import derived

pytestmark = pytest.mark.vcan

FRAMES = pytest.mark.parametrize("uri", ["can:socketcan:vcan0", "can:socketcan:vcan0?fd=0"], ids=["fd", "classic"])
CHANGES = ["duration=6", "reference.0.at=0.5", "seed=11"]
SLOTS, PERIOD_S = 120, 0.05
FROM_THE_RIG = {derived(fd=fd).sensors[0][0] for fd in (True, False)}  # of its first frame, which holds the slot in bytes 4 to 7


def session(uri: str, folder: Path, slots: int = SLOTS) -> Session:
    """The thesis's motor in real time, which in the guest may be virtual."""
    experiment = load_experiment("dc-motor-hinf", [*CHANGES, f"duration={slots * PERIOD_S}"])
    return run_session(experiment, clock="real", link=uri, path=folder / "run.mcap")


def assert_equals_the_virtual_run(run: Run, end: int) -> None:
    """Injected modes to the end; plant states and applied inputs, bit for bit, in the first `end` slots."""
    virtual = simulate(compose(load_experiment("dc-motor-hinf", CHANGES)), 11)
    for side in ("/network/sc", "/network/ca"):
        a, b = run.arrays[side], virtual.arrays[side]
        a, b = a[a["mode"] >= 0], b[b["mode"] >= 0]
        np.testing.assert_array_equal(a["mode"], b["mode"][: len(a)])
    for topic, fields in (("/plant/state", ("angle", "speed")), ("/actuator/applied", ("voltage", "d", "row"))):
        for name in fields:
            np.testing.assert_array_equal(run.arrays[topic][name][:end], virtual.arrays[topic][name][:end])


@contextmanager
def alongside(script: str) -> Iterator[None]:
    """A shell script that runs beside the block and must succeed."""
    beside = subprocess.Popen(["sh", "-ec", script])
    try:
        yield
        assert beside.wait(30) == 0
    finally:
        beside.kill()
        beside.wait()


@FRAMES
@pytest.mark.usefixtures("virtual_time")
def test_session_in_virtual_time_equals_the_one_process_run_to_the_end(uri: str, tmp_path: Path) -> None:
    done = session(uri, tmp_path)
    assert done.status == 0, done.summary
    assert done.summary["timing"]["valid"]
    assert done.summary["timing"]["first_late_slot"] is None
    assert_equals_the_virtual_run(done.run, SLOTS)
    assert verify(done.run).difference is None


@FRAMES
@pytest.mark.realtime
def test_session_in_real_time_equals_the_one_process_run_up_to_the_first_late_slot(uri: str, tmp_path: Path) -> None:
    done = session(uri, tmp_path, slots=40)
    late = done.summary["timing"]["first_late_slot"]
    assert done.status == 0 or late is not None, done.summary  # a machine that stalls for long may trip the watchdog
    assert_equals_the_virtual_run(done.run, 40 if late is None else late)
    assert done.summary["log"]["dropped"] == 0


@contextmanager
def down_after(slot: int, seconds: float) -> Iterator[None]:
    """Take vcan0 down half a period after the rig's frame of a slot, for so long: the slots that are lost are always the same."""
    watching, ended = threading.Event(), threading.Event()

    def watch() -> None:
        with can.Bus("vcan0", interface="socketcan", fd=True) as bus:
            watching.set()
            while not ended.is_set():
                frame = bus.recv(0.2)
                if frame is None or frame.arbitration_id not in FROM_THE_RIG:
                    continue
                if int.from_bytes(frame.data[4:8], "little") == slot:
                    break
        for wait_s, state in ((0.5 * PERIOD_S, "down"), (seconds, "up")):
            ended.wait(wait_s)
            subprocess.run(["ip", "link", "set", "vcan0", state], check=True)

    beside = threading.Thread(target=watch)
    beside.start()
    try:
        assert watching.wait(60)
        yield
    finally:
        ended.set()
        beside.join(30)
    assert not beside.is_alive()


@FRAMES
@pytest.mark.usefixtures("virtual_time")
def test_link_down_for_two_slots_costs_packets_and_nothing_else(uri: str, tmp_path: Path) -> None:
    with down_after(slot=40, seconds=2 * PERIOD_S):
        done = session(uri, tmp_path)
    assert done.status == 0, done.summary
    assert done.summary["timing"]["first_late_slot"] == 41
    assert np.flatnonzero(done.run.arrays["/timing/slot"]["late"]).tolist() == [41, 42]
    assert_equals_the_virtual_run(done.run, 41)
    assert abs(done.summary["metrics"]["steady_state_error"]) < 0.01


@pytest.mark.usefixtures("virtual_time")
def test_link_down_for_a_second_trips_the_watchdog_whose_safe_state_stays(tmp_path: Path) -> None:
    with alongside("sleep 3; ip link set vcan0 down; sleep 1; ip link set vcan0 up"):
        done = session("can:socketcan:vcan0", tmp_path)
    assert done.status == 3, done.summary
    assert "watchdog" in done.summary["safety"]
    applied = done.run.arrays["/actuator/applied"]
    safe = applied["status"] == 3
    assert safe.any()
    assert safe[np.argmax(safe) :].all()
    assert np.all(applied["voltage"][safe] == 0)


@pytest.mark.usefixtures("virtual_time")
def test_foreign_traffic_on_the_bus_changes_nothing(tmp_path: Path) -> None:
    """Other identifiers and formats, 200 frames a second: no node takes them for packets."""
    with can.Bus("vcan0", interface="socketcan", fd=True) as bus:
        foreign = [
            can.Message(arbitration_id=0x7FF, is_extended_id=False, data=bytes(8)),
            can.Message(arbitration_id=0x18FF0100, data=b"\xff" * 8),
            can.Message(arbitration_id=0x200, is_extended_id=False, is_fd=True, data=b"\x11" * 64),
        ]
        senders = [bus.send_periodic(message, 0.015) for message in foreign]
        done = session("can:socketcan:vcan0", tmp_path)
        for sender in senders:
            sender.stop()
    assert done.status == 0, done.summary
    assert_equals_the_virtual_run(done.run, SLOTS)
