"""`hil replay`: three questions to a log, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from hil.log.read import read_run
from hil.session.replay.over_link import onto
from tests.hil.cli.conftest import Hil


def test_without_an_option_it_verifies(cli: Hil, hil_log: Path) -> None:
    status, out, _ = cli("replay", hil_log)
    assert status == 0 and out.startswith("same bits: 80 control packets, 80 plant states\nrecords: SHA-256 ")


def test_tags_are_asked_only_of_a_log_that_has_them(cli: Hil, hil_log: Path, tmp_path: Path) -> None:
    key = tmp_path / "frames.key"
    key.write_text("00" * 16)
    key.chmod(0o600)
    status, out, err = cli("replay", hil_log, "--auth", key)
    assert status == 2 and not out and "no nonce of slot 0" in err
    status, out, err = cli("replay", hil_log, "--auth", key, "--onto", "can:hil:x")
    assert status == 2 and "--auth: needs --verify" in err
    key.chmod(0o644)
    status, out, err = cli("replay", hil_log, "--auth", key)
    assert status == 2 and not out and "chmod 600" in err


def test_another_controller_gives_a_series(cli: Hil, hil_log: Path, tmp_path: Path) -> None:
    status, out, _ = cli("replay", hil_log, "--controller", "h2", "-o", "h2.csv", "--json")
    assert status == 0 and json.loads(out)["inputs"]["voltage"]["rms"] > 0
    assert "written: again.csv\n" in cli("replay", hil_log, "--controller", "h2", "-o", "again.csv")[1]
    lines = (tmp_path / "h2.csv").read_text().splitlines()
    assert lines[0] == "t_s,recorded_voltage,h2_voltage" and len(lines) == 81


def test_frames_go_onto_a_bus(cli: Hil, hil_log: Path) -> None:
    status, out, _ = cli("replay", hil_log, "--onto", "can:hil:replaycli", "--speed", "50", "--json")
    assert status == 0 and json.loads(out)["frames"] == 160


def test_every_frame_that_is_put_on_a_bus_is_counted(hil_log: Path) -> None:
    counted: list[tuple[int, int]] = []
    onto(read_run(hil_log), "can:hil:replaycounted", 50.0, lambda done, total: counted.append((done, total)))
    assert counted == [(n, 160) for n in range(160)]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--verify", "--controller", "h2"], "choose one"),
        (["--controller", "nosuch"], "no controller plug-in is called 'nosuch'"),
        (["--controller", ""], "no controller plug-in is called ''"),
        (["--onto", ""], "link '': no scheme"),
        (["--onto", "memory:"], "runs in the rig's own process"),
        (["--onto", "can:hil:x", "--speed", "0"], "--speed: 0.0"),
        (["--onto", "can:hil:x", "--speed", "nan"], "--speed: nan"),
        (["--onto", "can:hil:x", "--speed", "1e-300"], "--speed: 1e-300"),
        (["--speed", "2"], "--speed: needs --onto"),
        (["--parameter", "gain=1"], "needs --controller"),
        (["-o", "x.csv"], "needs --controller"),
        (["--folder", "nowhere"], "folder 'nowhere': is no folder"),
        (["--controller", "h2", "-o", "nowhere/x.csv"], "no folder nowhere"),
        (["--controller", "h2", "-o", "."], "is a folder"),
    ],
)
def test_bad_input_is_one_message_and_status_2(
    cli: Hil, hil_log: Path, tmp_path: Path, arguments: list[str], says: str
) -> None:
    status, out, err = cli("replay", hil_log, *arguments)
    assert (status, out) == (2, "") and says in err
    assert [*tmp_path.iterdir()] == []


def test_a_series_is_never_overwritten(cli: Hil, hil_log: Path, tmp_path: Path) -> None:
    (tmp_path / "kept.csv").write_text("mine")
    assert cli("replay", hil_log, "--controller", "h2", "-o", "kept.csv")[0] == 2
    assert (tmp_path / "kept.csv").read_text() == "mine"
