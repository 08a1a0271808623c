"""`[[fault]]` on the bus of a link that takes time: the frames of rig and controller themselves are destroyed, or not sent."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from hil.errors import ExperimentError
from hil.experiment import load_experiment
from hil.session import Session, run_session
from tests.warm_hil import hil_command

pytestmark = pytest.mark.realtime

LINK = 'links.uri="can:hil:faults?timed=1&bitrate=1M&dbitrate=4M"'


def session(folder: Path, fault: str) -> Session:
    changes = ["allow_uncertified=true", LINK, "duration=2", "limits.watchdog_slots=8", f"fault=[{fault}]"]
    return run_session(load_experiment("dc-motor-hinf", changes), clock="real", path=folder / "run.mcap")


def behind(done: Session, kind: str) -> list[str]:
    """The error states of the rig behind the first event of a kind."""
    events: list[dict[str, Any]] = list(done.run.events)
    first = next(i for i, event in enumerate(events) if event["kind"] == kind)
    return [event["message"].partition(":")[0] for event in events[first:] if event["kind"] == "bus status"]


def test_disturbed_frames_of_the_rig_end_in_bus_off_and_the_watchdog_trips(tmp_path: Path) -> None:
    done = session(tmp_path, "{at=0.5, for=0.3, kind='bit-errors', can_id=0x100}")
    states = behind(done, "fault: bit-errors")
    assert states[-2:] == ["the rig on its link is error passive", "the rig on its link is off the bus"]
    assert done.status == 3 and "watchdog" in done.summary["safety"]


def test_a_rig_that_is_off_the_bus_for_a_while_sends_nothing_and_comes_back(tmp_path: Path) -> None:
    done = session(tmp_path, "{at=0.5, for=0.2, kind='bus-off', link='sc'}")
    states = behind(done, "fault: bus-off")
    assert states[:2] == ["the rig on its link is off the bus", "the rig on its link is error active"]
    late = done.run.arrays["/timing/slot"]["late"]
    assert done.status == 0 or late.any()  # on a machine that stalls the watchdog may trip


def test_bits_are_disturbed_where_there_are_bits_only(tmp_path: Path) -> None:
    fault = "fault=[{at=0.5, for=0.3, kind='bit-errors', rate=1e-3}]"
    linked = load_experiment("dc-motor-hinf", [LINK, "allow_uncertified=true", fault])
    with pytest.raises(ExperimentError, match=r"fault\[0\].kind: this run has no bus whose bits could be disturbed: a link"):
        run_session(linked, path=tmp_path / "run.mcap")
    with pytest.raises(ExperimentError, match=r"fault\[0\].kind: there is no CAN bus with time, .* or links.uri = "):
        run_session(load_experiment("dc-motor-hinf", [fault]), path=tmp_path / "run.mcap")


def test_a_run_says_once_that_a_bit_rate_times_nothing(tmp_path: Path) -> None:
    done = hil_command("run", "dc-motor-hinf", "--link", "can:hil:untimed?bitrate=500k", "--clock", "real", "--duration", "0.5",
                       "--quiet", "-o", "run.mcap", cwd=tmp_path)  # fmt: skip
    said = "hil: bitrate times nothing on this bus; add timed=True for a bus that takes time\n"
    assert done.stderr == said, "a line, and not one of Python"
