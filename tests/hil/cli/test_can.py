"""`hil can bridge`: what it refuses; `hil dbc`: the file, a C codec that compiles and reads our bytes, a log decoded."""

from __future__ import annotations

import json
import math
import shutil
import subprocess
from pathlib import Path

import msgspec
import pytest
from click.testing import CliRunner

import hil
from hil.cli import main
from hil.cli.can import c_codec, database_of
from hil.cli.can import can as can_command
from hil.cli.can import dbc as command
from hil.errors import HilError
from hil.experiment import load_experiment
from hil.session import run_session
from tests.waiting import LIMIT_S
from tests.warm_hil import hil_command
from transport import SensorPacket, dbc_path, encode_sensor
from transport.links.python_can import can  # without pandas


def test_it_prints_the_dbc() -> None:
    assert CliRunner().invoke(command, []).stdout == dbc_path().read_text(encoding="utf-8")


def test_the_c_codec_is_that_of_the_dbc_and_says_where_it_is(tmp_path: Path) -> None:
    done = CliRunner().invoke(command, ["--c", str(tmp_path / "codec")])
    files = [tmp_path / "codec" / name for name in ("hilrig.h", "hilrig.c")]
    assert done.exit_code == 0 and done.stdout.splitlines() == [str(file) for file in files]
    assert tuple(file.read_text() for file in files) == c_codec(database_of(dbc_path().read_text(encoding="utf-8")))
    assert "struct hilrig_sensor_fd0_t {" in files[0].read_text()


def test_files_in_the_way_are_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "hilrig.c").write_text("mine")
    with pytest.raises(SystemExit) as end:
        main(["dbc", "--c", str(tmp_path)])
    assert end.value.code == 2 and "exists already" in capsys.readouterr().err
    assert (tmp_path / "hilrig.c").read_text() == "mine" and not (tmp_path / "hilrig.h").exists()


@pytest.mark.parametrize("ending", ["log", "blf"])
def test_an_exported_log_is_decoded_to_what_was_measured(tmp_path: Path, ending: str) -> None:
    session = hil.run("dc-motor-hinf", duration=2, log=tmp_path / "run.mcap")
    with pytest.raises(SystemExit):
        main(["export", str(tmp_path / "run.mcap"), "-o", str(tmp_path / f"run.{ending}")])
    done = CliRunner().invoke(command, ["--decode", str(tmp_path / f"run.{ending}")])
    frames = [json.loads(line) for line in done.stdout.splitlines()]
    sensor = {frame["Seq"]: frame for frame in frames if frame["frame"] == "SensorFD0" and frame["Empty"] == 0}
    assert len(frames) == 80 and len(sensor) > 30 and frames[0]["Kind"] == "sensor"
    measured = session.arrays["/plant/measurement"]
    period_ns = 50_000_000
    for frame in sensor.values():
        (row,) = measured[measured["slot"] == frame["SampleTime"] // period_ns]
        assert frame["Y0"] == pytest.approx(row["angle"], abs=1e-6)


@pytest.mark.parametrize("content", [None, b"", b"\0\xff garbage"])
def test_what_is_no_can_log_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str], content: bytes | None) -> None:
    log = tmp_path / "a.blf"
    if content is not None:
        log.write_bytes(content)
    for path in (log, tmp_path / "a.txt"):
        with pytest.raises(SystemExit) as end:
            main(["dbc", "--decode", str(path)])
        assert end.value.code == 2 and str(path) in capsys.readouterr().err


def test_a_log_without_a_frame_of_the_dbc_is_named(tmp_path: Path) -> None:
    (tmp_path / "car.log").write_text("(1.000000) can0 123#0021\n")
    with pytest.raises(HilError, match=r"car\.log: no frame is of a packet of this DBC"):
        CliRunner().invoke(command, ["--decode", str(tmp_path / "car.log")], catch_exceptions=False)


@pytest.mark.parametrize(("length", "fd"), [(64, "?base=0x200"), (8, "?base=0x200&fd=0")])
def test_a_foreign_frame_with_an_identifier_of_ours_is_left_out_and_said(tmp_path: Path, length: int, fd: str) -> None:
    packet = encode_sensor(SensorPacket(7, 0, 0, (0.25,)))
    wrong = packet[:2] + b"\x30" + packet[3:]
    at, classic = "200" if length == 64 else "280", length == 8
    ours = packet[:length]
    foreign = [wrong[:length], ours[:7]] + ([] if classic else [packet[:-1] + b"\1"])
    mark = "#" if classic else "##1"
    lines = [f"(1.0) can0 {at}{mark}{each.hex()}" for each in (ours, *foreign)]
    lines += [f"(1.0) can0 00000{at}{mark}{ours.hex()}", f"(1.0) can0 {at}#R8"]
    (tmp_path / "run.log").write_text("\n".join(lines) + "\n")
    asked = ["dc-motor-hinf", "--link", f"can:hil:x{fd}", "--decode", str(tmp_path / "run.log")]
    done = CliRunner().invoke(command, asked, catch_exceptions=False)
    assert [json.loads(line)["Seq"] for line in done.stdout.splitlines() if line.startswith("{")] == [7]
    assert f"{len(foreign) + 2} frames have an identifier of this DBC and are of no packet" in done.stderr


def test_what_a_packet_holds_is_json_whatever_number_it_is(tmp_path: Path) -> None:
    packet = encode_sensor(SensorPacket(7, 0, 0, (math.nan,), reference=(math.inf,)))
    (tmp_path / "run.log").write_text(f"(1.0) can0 100##1{packet.hex()}\n")
    done = CliRunner().invoke(command, ["dc-motor-hinf", "--decode", str(tmp_path / "run.log")], catch_exceptions=False)
    said = msgspec.json.decode(done.stdout)
    assert (said["angle_0"], said["ref_angle"]) == ("nan", "inf")


def test_each_node_has_messages_of_its_own_which_read_as_what_it_measured(tmp_path: Path) -> None:
    controller = "controller={kind='local', gain=[[-0.05, -0.006]]}"
    changes = [controller, "duration=1", "reference.0.at=0.1"]
    session = run_session(load_experiment("dc-motor-two-nodes", changes), path=tmp_path / "run.mcap")
    with pytest.raises(SystemExit):
        main(["export", str(tmp_path / "run.mcap"), "-o", str(tmp_path / "run.log")])
    with can.LogReader(tmp_path / "run.log") as log:
        received = {frame.arbitration_id for frame in log}
    assert received == {0x100, 0x120, 0x140}
    done = CliRunner().invoke(command, ["dc-motor-two-nodes", "--decode", str(tmp_path / "run.log")])
    frames = [json.loads(line) for line in done.stdout.splitlines()]
    sensor = [f for f in frames if f["Kind"] == "sensor" and not f["Empty"]]
    names = {"Sensor_angle_FD0": ("angle", 0), "Sensor_speed_FD0": ("speed", 1)}
    assert {f["frame"] for f in sensor} == {*names} and all(f["References"] == 2 for f in frames if "References" in f)
    y = session.run.arrays["/plant/measurement"]
    for f in sensor:
        (output, number), k = names[f["frame"]], f["SampleTime"] // 50_000_000
        assert f["Node"] == number and f[f"{output}_0"] == pytest.approx(y[output][k], rel=1e-6, abs=1e-9) and k <= f["Seq"]
    assert len(sensor) > 15 and any(f.get("angle_0") for f in sensor) and any(f.get("speed_0") for f in sensor)
    empty = [f for f in frames if f["Kind"] == "sensor" and f["Empty"]]
    assert empty and all("ref_angle_alone" in f and "angle_0" not in f for f in empty)


NODES = """
#include <stdio.h>
#include "hilrig.h"
int main(void) {
    uint8_t bytes[64]; struct hilrig_sensor_first_fd0_t a; struct hilrig_sensor_third_fd0_t c;
    if (fread(bytes, 1, 64, stdin) != 64 || hilrig_sensor_third_fd0_unpack(&c, bytes, 64)) return 1;
    if (hilrig_sensor_first_fd0_unpack(&a, bytes, 64)) return 1;
    printf("%x %x %d %.9g %.9g %lu %lld", HILRIG_SENSOR_FIRST_FD0_FRAME_ID, HILRIG_SENSOR_THIRD_FD0_FRAME_ID, c.node,
           (double)c.x3_1, (double)c.ref_x4, (unsigned long)c.seq, (long long)c.sample_time);
    return 0;
}
"""


@pytest.mark.skipif(shutil.which("gcc") is None, reason="no C compiler: apt-get install gcc")
def test_the_c_codec_of_an_experiment_has_a_message_for_each_node(tmp_path: Path) -> None:
    words = ["multisensor-published", "--set", "network.nodes.third.can_id=0x90", "--c", str(tmp_path)]
    done = CliRunner().invoke(command, words, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    (tmp_path / "main.c").write_text(NODES)
    subprocess.run(["gcc", "-Wall", "-Werror", "-O0", "-o", "read", "main.c", "hilrig.c"], cwd=tmp_path, check=True, timeout=120)
    packet = SensorPacket(70000, 0, -5, (1.5, 2.5, 3.5), 2, 3, (0.0, 0.0, 0.0, 7.0), 4)
    data = encode_sensor(packet).ljust(64, b"\0")
    text = subprocess.run([tmp_path / "read"], input=data, capture_output=True, check=True, timeout=LIMIT_S).stdout
    assert text.split() == [b"100", b"90", b"2", b"2.5", b"7", b"70000", b"-5"]


def test_a_dbc_of_no_experiment_takes_no_link() -> None:
    done = CliRunner().invoke(command, ["--link", "can:hil:rig0"])
    assert done.exit_code and "name an experiment" in str(done.exception)


def test_a_bridge_to_an_interface_that_is_not_there_and_impossible_rates_are_refused() -> None:
    for rate, name, said in (
        ("501k", "vcan9", "bitrate: 501000 bit/s: no whole part of 80000000 Hz; the nearest possible is 500000"),
        ("500k", "vcan9", "interface 'vcan9': "), ("500k", "vcan9\n", r"interface 'vcan9\n': "), ("500k", "", "interface '': "),
    ):  # fmt: skip
        with pytest.raises(HilError) as caught:
            words = ["bridge", "cli", name, "--bitrate", rate]
            CliRunner().invoke(can_command, words, catch_exceptions=False, standalone_mode=False)
        assert said in str(caught.value) and ("is it there and up?" in str(caught.value)) is (rate == "500k")


def test_a_command_that_is_not_there_is_said_before_a_kernel_is_built(tmp_path: Path) -> None:
    done = hil_command("vcan", "--", "no-such-program", "--install", cwd=tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (127, "", "hil vcan: there is no command no-such-program\n")
