"""The guide's drive, which keeps its own CAN messages, controls the motor; what an experiment says wrongly of them is refused."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

import hil
from hil.errors import ExperimentError
from hil.experiment import load_experiment
from hil.log.read import Run
from hil.rig import rig_of
from hil.rig.session_link import link_of
from hil.session import Session, run_session
from transport.packets import ControlPacket, SensorPacket, decode

pytestmark = pytest.mark.realtime

PAGE = (Path(hil.__file__).parent / "guide" / "own-messages.md").read_text(encoding="utf-8")


GAIN = 0.08
ONE_BIT_V = 0.001


def block(kind: str, which: int = 0) -> str:
    """A block of the guide, word for word."""
    return re.findall(rf"```{kind}\n(.*?)```", PAGE, re.S)[which]


def bench(folder: Path) -> Path:
    """The guide's files."""
    (folder / "drive.dbc").write_text(re.findall(r"```\n(VERSION.*?)```", PAGE, re.S)[0], encoding="utf-8")
    (folder / "drive.py").write_text(block("python"), encoding="utf-8")
    (folder / "bench.toml").write_text(block("toml"), encoding="utf-8")
    return folder / "bench.toml"


@contextmanager
def drive(folder: Path, interface: str, channel: str) -> Iterator[None]:
    """The guide's drive, running."""
    program = subprocess.Popen([sys.executable, "drive.py", interface, channel], cwd=folder)
    try:
        yield
    finally:
        program.kill()
        program.wait()


def run_of(folder: Path, link: str, *changes: str) -> Session:
    """The guide's experiment with the drive beside it."""
    experiment = load_experiment(str(bench(folder)), ["duration=2", "reference.0.at=0.2", "limits.watchdog_slots=40", *changes])
    _, interface, channel = link.split(":")
    with drive(folder, interface, channel):
        return run_session(experiment, clock="real", link=link, path=folder / "run.mcap", external=True, wait_s=60.0)


def laws_and_commands(run: Run) -> dict[int, tuple[float | None, float]]:
    """By slot that was answered in time: what the drive's law gives for its sample, None where none arrived; the command."""
    asked, found = {}, {}
    for row in run.arrays["/link/sensor"]:
        packet = decode(bytes(row["data"]))
        assert isinstance(packet, SensorPacket)
        asked[packet.seq] = GAIN * (packet.reference[0] - packet.y[0]) if packet.y else None
    for row in run.arrays["/link/control"]:
        packet = decode(bytes(row["data"]))
        assert isinstance(packet, ControlPacket)
        if not row["late"]:
            found[packet.seq] = (asked[packet.seq], packet.rows[0][0])
    return found


def test_the_drive_of_the_guide_commands_what_its_law_says_of_the_sample_that_it_got(tmp_path: Path) -> None:
    session = run_of(tmp_path, f"can:hil:own{os.getpid()}")
    found = laws_and_commands(session.run)
    assert session.summary["controller"] == "external" and session.summary["certificate"]["state"] == "undecided"
    counted = session.summary["link_counters"]
    assert counted["malformed"] == counted["foreign"] == 0
    assert len(found) > 5, session.summary
    laws = [0.0] + [law for law, _ in found.values() if law is not None]
    for law, command in found.values():
        # What a stalled machine delays beyond a slot answers a later sample, as the guide says.
        near = min(abs(command - each) for each in laws)
        assert near <= 2 * ONE_BIT_V, (law, command)
    assert sum(law is None or abs(command - law) <= 2 * ONE_BIT_V for law, command in found.values()) > len(found) / 2
    assert any(abs(command) > 0.05 for _, command in found.values()), "the step came"


def link_text(path: Path, *changes: str, external: bool = True) -> str:
    return link_of(rig_of(load_experiment(str(path), changes)), external=external).uri


def test_the_table_becomes_options_of_the_link_for_an_external_controller_alone(tmp_path: Path) -> None:
    path = bench(tmp_path)
    assert link_text(path, external=False) == "can:hil:bench"
    assert link_text(path, "links.messages.valid=0.06") == (
        f"can:hil:bench?dbc={tmp_path}/drive.dbc&outputs=Encoder.Angle*57.29577951308232&references=Setpoint.Angle:rad"
        "&inputs=DriveCommand.Voltage:V&counters=Encoder.Alive&valid=0.06"
    )


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("{ voltage =", "{ current =", ["inputs.current: the plant has no such input (there are: voltage)",
                                        "inputs: no signal commands 'voltage'"]),
        ("{ angle = \"Setpoint", "{ speed = \"Setpoint", ["references.speed: the plant has no such output (there are: angle)"]),
        ("*57.29577951308232", "", ["outputs: Encoder.Angle is in 'deg', the rig's value in 'rad'; say the factor: "
                                    "Encoder.Angle*57.29577951308232"]),
        ("Setpoint.Angle", "Setpoint.Angel", ["references: no signal of Setpoint is called 'Angel', did you mean 'Angle'?"]),
    ],
)  # fmt: skip
def test_a_table_that_fits_neither_plant_nor_database_is_refused(tmp_path: Path, old: str, new: str, said: list[str]) -> None:
    path = bench(tmp_path)
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(ExperimentError) as caught:
        link_text(path)
    assert caught.value.faults == [f"links.messages.{each}" for each in said]


def test_a_link_without_can_messages_is_refused_in_the_file(tmp_path: Path) -> None:
    path = bench(tmp_path)
    path.write_text(path.read_text().replace("can:hil:bench", "zenoh:"))
    with pytest.raises(ExperimentError, match=r"links\.messages: the link 'zenoh:' does not take it; only a CAN link does"):
        load_experiment(str(path))
