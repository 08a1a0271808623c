"""Commands that read a log say in one line what is wrong with it, and write nothing then."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.hil.cli.conftest import Hil

COMMANDS = {
    "report": ["-o", "out.html"],
    "replay": [],
    "export": ["-o", "out.log"],
    "recover": ["-o", "out.mcap"],
}


@pytest.mark.parametrize("command", COMMANDS)
def test_what_is_no_log_is_refused(cli: Hil, tmp_path: Path, command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hil.pages.run_page.MOST_FOLDERS", 100)  # of /proc
    (tmp_path / "empty.mcap").touch()
    (tmp_path / "junk.mcap").write_bytes(b"\x00\xff" * 4000)
    (tmp_path / "folder").mkdir()
    folder = "holds no .mcap file" if command == "report" else "is a folder"  # `hil report` takes a folder of logs
    for name, says in {
        "nosuch.mcap": "No such file",
        "folder": folder,
        "empty.mcap": "is empty",
        "junk.mcap": "is no MCAP file",
        "folder/.": folder,
        "/proc": folder,
        "/dev/zero": "is no regular file",
    }.items():
        status, out, err = cli(command, name, *COMMANDS[command])
        assert (status, out) == (2, "") and says in err
    assert not [*tmp_path.glob("out*")]
    for name in ("folder", "/proc"):  # without -o, too
        assert command == "export" or cli(command, name)[0] == 2


@pytest.mark.parametrize("command", ["report", "replay", "export"])
def test_a_torn_log_is_refused_with_the_remedy(cli: Hil, hil_log: Path, tmp_path: Path, command: str) -> None:
    (tmp_path / "torn ü.mcap").write_bytes(hil_log.read_bytes()[:-9000])
    status, _, err = cli(command, "torn ü.mcap", *COMMANDS[command])
    assert status == 2 and "hil recover torn ü.mcap" in err


def test_what_is_recovered_can_be_replayed_and_is_not_overwritten(cli: Hil, hil_log: Path, tmp_path: Path) -> None:
    (tmp_path / "torn.mcap").write_bytes(hil_log.read_bytes()[:-9000])
    status, out, _ = cli("recover", "torn.mcap")
    assert status == 0 and "written: torn.recovered.mcap" in out and "lost:" in out
    assert cli("replay", "torn.recovered.mcap")[0] == 0
    assert cli("recover", "torn.mcap")[0] == 2


def test_recover_says_when_hil_cannot_read_what_it_kept(cli: Hil, hil_log: Path, tmp_path: Path) -> None:
    data = hil_log.read_bytes()
    (tmp_path / "torn.mcap").write_bytes(data[: data.index(b"hilrig", 40) + 8])
    status, out, _ = cli("recover", "torn.mcap")
    assert status == 0 and "lost: the metadata record 'hilrig', without which hil cannot read" in out


@pytest.mark.parametrize(("target", "says"), [("x.foo", "names no format"), ("no/x.log", "cannot be written")])
def test_export_refuses_what_it_cannot_write(cli: Hil, hil_log: Path, target: str, says: str) -> None:
    status, out, err = cli("export", hil_log, "-o", target)
    assert (status, out) == (2, "") and says in err


def test_export_names_the_topics_there_are(cli: Hil, hil_log: Path) -> None:
    status, _, err = cli("export", hil_log, "-o", "x.csv", "--topic", "/plant/stat")
    assert status == 2 and "/plant/state" in err
    assert cli("export", hil_log, "-o", "x.csv", "--topic", "/plant/state")[1] == "x.csv\n"


def test_report_writes_one_page_and_spares_the_log(cli: Hil, hil_log: Path, tmp_path: Path) -> None:
    before = hil_log.read_bytes()
    assert cli("report", hil_log, "-o", "page.html")[0] == 0
    assert "<html" in (tmp_path / "page.html").read_text()
    for target, says in ((hil_log, "is the log itself"), (".", "is a folder"), ("no/x.html", "no folder no")):
        status, out, err = cli("report", hil_log, "-o", target)
        assert (status, out) == (2, "") and says in err
    assert hil_log.read_bytes() == before
