"""`hil identify plant`: from our own logs at both rates, from tables, and what is no record of an axis; `hil identify rates`."""

from __future__ import annotations

import csv
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from design.identification.jump_rates import JumpRate
from hil.log.read import read_run
from tests.design.identification.test_dry_friction import CHIRP, braked
from tests.hil.cli.conftest import Hil, run_main


@pytest.fixture(scope="module")
def omni_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("omni") / "omni.mcap"
    assert run_main("run", "omni-identify", "-o", str(path)) == 0
    return path


@pytest.mark.parametrize(
    "rate",
    [["--duration", "30"], pytest.param(["--set", "period=0.001", "--duration", "11"], marks=pytest.mark.slow)],
    ids=["20 Hz", "1 kHz"],
)
def test_the_logged_omni_is_found_within_1_percent(cli: Hil, rate: list[str]) -> None:
    assert cli("run", "omni-identify", *rate, "-o", "omni.mcap")[0] == 0
    status, out, _ = cli("identify", "plant", "omni.mcap", "--json")
    said = json.loads(out)
    assert status == 0 and said["residuals"]["verdict"] == "white" and said["noise_sd"] == pytest.approx(1e-3, rel=0.1)
    for name, truth in (("inertia", 0.7943), ("damping", 1.9857)):
        assert abs(said["estimates"][name]["value"] / truth - 1) < 0.01
        assert said["plain_least_squares"] is None or abs(said["plain_least_squares"][name] / truth - 1) > 0.2


def test_the_motor_of_a_session_over_a_network_is_found_with_its_disturbance(cli: Hil) -> None:
    assert cli("run", "dc-motor-hinf", "--duration", "35", "-o", "motor.mcap")[0] == 0
    said = json.loads(cli("identify", "plant", "motor.mcap", "--json")[1])
    assert said["plant"] == "dc-motor" and said["residuals"]["verdict"] == "exact"
    assert said["estimates"]["gain"]["value"] == pytest.approx(172.38, rel=1e-9)
    assert said["estimates"]["pole"]["value"] == pytest.approx(3.5287, rel=1e-9)
    assert said["logged"] == {"gain": 172.38, "pole": 3.5287}
    text = cli("identify", "plant", "motor.mcap")[1]
    assert "residuals            none: the model fits to rounding\n" in text and "(Q = " not in text
    assert " rad (standard deviation), 700 samples" in text
    assert "gain                 172.38 rad/(V s²), 95 %: " in text


def test_a_motor_with_friction_is_distinguished_from_one_without(cli: Hil) -> None:
    sets = ["--set", "plant.friction.coulomb_v=0.01", "--set", "allow_uncertified=true"]
    assert cli("run", "dc-motor-hinf", *sets, "-o", "motor.mcap")[0] == 0
    status, out, _ = cli("identify", "plant", "motor.mcap")
    assert status == 1 and "the model or the noise is another" in out


def test_dry_friction_that_white_residuals_hide_is_seen(cli: Hil, tmp_path: Path) -> None:
    y = braked(CHIRP, 0.02) + 0.01 * np.random.default_rng(2).standard_normal(CHIRP.size)
    rows = "".join(f"{0.02 * k},{angle},{u}\n" for k, (angle, u) in enumerate(zip(y.tolist(), CHIRP.tolist())))
    (tmp_path / "motor.csv").write_text(f"t_s,angle,voltage\n{rows}")
    status, out, _ = cli("identify", "plant", "motor.csv", "--plant", "dc-motor", "--json")
    found = json.loads(out)
    assert status == 1 and found["residuals"]["verdict"] == "white" and found["friction"]["seen"]
    assert "the intervals do not hold" in " ".join(cli("identify", "plant", "motor.csv", "--plant", "dc-motor")[1].split())


def test_what_would_not_be_seen_is_said(cli: Hil, omni_log: Path) -> None:
    status, out, _ = cli("identify", "plant", omni_log)
    assert status == 0 and re.search(r"residuals white: .* \(Q = \S+ over \d+ lags, p = \S+\)", " ".join(out.split()))
    assert "the intervals hold if there is none: as much would not be seen here" in " ".join(out.split())


def write_table(path: Path, log: Path, clock: str = "t_s", skip: int | None = None) -> None:
    run = read_run(log)
    y, u = run.arrays["/plant/measurement"], run.arrays["/actuator/applied"]
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow([f"{clock} [{'ns' if clock == 't_ns' else 's'}]", "angle [rad]", "torque [N·m]"])
        for k in range(len(u)):
            if k != skip:
                t = int(y["t_ns"][k])
                writer.writerow([t if clock == "t_ns" else t / 1e9, float(y["angle"][k]), float(u["torque"][k])])


@pytest.mark.parametrize("clock", ["t_s", "t_ns"])
def test_a_table_says_what_its_log_says(cli: Hil, omni_log: Path, tmp_path: Path, clock: str) -> None:
    write_table(tmp_path / "omni.csv", omni_log, clock)
    of_log = json.loads(cli("identify", "plant", omni_log, "--json")[1])["estimates"]
    of_table = json.loads(cli("identify", "plant", "omni.csv", "--plant", "omni", "--json")[1])["estimates"]
    for name, found in of_log.items():
        assert of_table[name] == pytest.approx(found, rel=1e-9)
    assert cli("identify", "plant", "omni.csv", "--plant", "omni", "--input", "torque", "--measured", "angle")[0] == 0


def test_faults_are_reported_with_status_2(cli: Hil, omni_log: Path, tmp_path: Path, hil_log: Path) -> None:
    write_table(tmp_path / "good.csv", omni_log)
    write_table(tmp_path / "gap.csv", omni_log, skip=5)
    lines = (tmp_path / "good.csv").read_text().splitlines()
    (tmp_path / "back.csv").write_text("\n".join([*lines[:9], lines[3], *lines[9:]]))
    (tmp_path / "word.csv").write_text("\n".join([*lines[:9], "1,two,3"]))
    (tmp_path / "ragged.csv").write_text("\n".join([*lines[:9], "1,2"]))
    (tmp_path / "jitter.csv").write_text("\n".join([*lines[:9], lines[9].replace(lines[9].split(",")[0], "0.42"), *lines[10:]]))
    (tmp_path / "degrees.csv").write_text("\n".join([lines[0].replace("[rad]", "[deg]"), *lines[1:]]))
    (tmp_path / "zero.csv").write_text("\n".join([lines[0], *(f"{k},0,0" for k in range(50))]))
    (tmp_path / "clock.csv").write_text("x,angle,torque\n1,2,3\n")
    (tmp_path / "binary.csv").write_bytes(b"t,angle\n\xff\xfe")
    (tmp_path / "empty.csv").touch()
    omni = ["--plant", "omni"]
    for arguments, says in (
        (["good.csv"], "--plant"),
        (["nosuch.csv"], "nosuch.csv: cannot be read: No such file"),
        (["good.csv", *omni, "--input", "force"], "no column 'force'"),
        (["gap.csv", *omni], "input 5 is missing"),
        (["back.csv", *omni], "does not grow"),
        (["word.csv", *omni], "word.csv:10"),
        (["ragged.csv", *omni], "2 entries"),
        (["jitter.csv", *omni], "off a multiple"),
        (["degrees.csv", *omni], "degrees.csv: angle is in 'deg', expected rad"),
        (["zero.csv", *omni], "does not move"),
        (["clock.csv", *omni], "no column of times"),
        (["binary.csv", *omni], "is no CSV"),
        (["empty.csv", *omni], "no column of times"),
        (["nosuch.mcap"], "No such file"),
        ([omni_log, hil_log], "different plants"),
        ([omni_log, "--input", "force"], "no signal 'force'"),
    ):
        status, out, err = cli("identify", "plant", *arguments)
        assert (status, out) == (2, "") and says in err, (arguments, err)


def test_the_command_reads_logs_and_refuses_one_without_modes(cli: Hil, hil_log: Path) -> None:
    assert cli("run", "vtol-fault", "--duration", "1", "--seed", "2", "-o", "1.mcap")[0] == 0
    shutil.copy("1.mcap", "2.mcap")
    status, out, _ = cli("identify", "rates", "1.mcap", "2.mcap", "--edge", "0.3s", "--json")
    found = [JumpRate(**each) for each in json.loads(out)["rates"]]
    assert status == 0 and found[0].fault is None and {each.after_s for each in found} == {0.0, 0.3}
    of_fault = {(each.source, each.after_s): each.exposure_s for each in found if each.fault is None}
    assert sum(of_fault.values()) == pytest.approx(2.0, abs=0.01)
    assert "1/s, 95 %" in cli("identify", "rates", "1.mcap")[1]
    status, _, err = cli("identify", "rates", "1.mcap", "--detected", "pitch_rate")
    assert status == 2 and "pitch_rate is no mode" in err
    status, _, err = cli("identify", "rates", hil_log)
    assert status == 2 and "no mode 'fault_mode'" in err and "angle" in err
