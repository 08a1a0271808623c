"""What a command writes: refused before the work where it cannot be, and never half there."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

import hil
from hil.errors import HilError
from hil.files import check_output, check_page, write_output
from tests.file_limit import files_up_to
from tests.hil.cli.conftest import Hil


def test_what_does_not_fit_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "page.html"
    path.write_text("old")
    with files_up_to(4000), pytest.raises(HilError, match=r"page\.html: cannot be written: File too large"):
        write_output(path, "x" * 100_000)
    assert path.read_text() == "old" and os.listdir(tmp_path) == ["page.html"]


def test_a_link_is_followed_and_a_name_may_be_as_long_as_names_can_be(tmp_path: Path) -> None:
    real, link = tmp_path / ("n" * 255), tmp_path / "link"
    link.symlink_to(real)
    check_output(link, force=True)
    write_output(link, "text")
    assert link.is_symlink() and real.read_text() == "text"


def test_half_characters_of_a_foreign_text_are_escaped(tmp_path: Path) -> None:
    write_output(tmp_path / "page.html", "no file \udcff")
    assert (tmp_path / "page.html").read_text() == "no file \\udcff"


def test_what_is_no_regular_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "pipe"
    os.mkfifo(path)
    with pytest.raises(HilError, match="is no regular file"):
        check_output(path)
    with pytest.raises(HilError, match="is no regular file"):
        write_output(path, "text")
    assert path.is_fifo()


def test_a_folder_that_takes_no_file_is_reported_before_the_work() -> None:
    with pytest.raises(HilError, match="cannot be written"):
        check_output(Path("/proc/x"))  # root may write there, says access()
    with pytest.raises(HilError, match="cannot be written: File name too long"):
        check_output(Path("x" * 300))


@pytest.mark.parametrize("command", [["report", "LOG"], ["reproduce", "ch2"], ["compare", "dc-motor-hinf", "--runs", "2"]])
def test_a_page_replaces_only_a_page(cli: Hil, hil_log: Path, tmp_path: Path, command: list[str]) -> None:
    notes = tmp_path / "notes.html"
    notes.write_text("mine")
    words = [hil_log if word == "LOG" else word for word in command]
    status, out, err = cli(*words, "-o", notes)
    assert (status, out) == (2, "") and "exists already and is no report" in err and "--force" in err
    status, out, err = cli(*words, "-o", tmp_path / "notes.md", "--force")
    assert (status, out) == (2, "") and "a page is written here; expected a name that ends in .html" in err
    assert notes.read_text() == "mine" and os.listdir(tmp_path) == ["notes.html"]
    check_page(notes, force=True)
    notes.write_text("<!DOCTYPE html>\n")
    check_page(notes)


def test_report_takes_force_and_then_replaces_any_file(cli: Hil, hil_log: Path, tmp_path: Path) -> None:
    notes = tmp_path / "notes.html"
    notes.write_text("mine")
    assert cli("report", hil_log, "-o", notes, "--force")[0] == 0 and notes.read_text().lower().startswith("<!doctype html")
    assert cli("report", hil_log, "-o", notes)[0] == 0


def test_a_page_is_no_gains_file(cli: Hil, tmp_path: Path) -> None:
    for question in (("--trigger",), ("--trade-off",), ("--can-id",)):
        status, out, err = cli("design", "dc-motor-ours-h2", *question, "-o", tmp_path / "gains.json")
        assert (status, out) == (2, "") and "gains.json: a page is written here" in err
    assert not os.listdir(tmp_path)


@pytest.mark.parametrize(
    ("words", "ending"),
    [
        (("run", "dc-motor-hinf", "-o", "x.html"), ".mcap"),
        (("live", "dc-motor-hinf", "-o", "x.html"), ".mcap"),
        (("recover", "LOG", "-o", "x.html"), ".mcap"),
        (("probe", "can:hil:nobody", "-o", "x.html"), ".mcap"),
        (("replay", "LOG", "--controller", "h2", "-o", "x.html"), ".csv"),
        (("layout", "plotjuggler", "LOG", "-o", "x.html"), ".xml"),
        (("layout", "foxglove", "LOG", "-o", "x.html"), ".json"),
        (("design", "dc-motor", "-o", "x.html"), ".json"),
        (("design", "wall", "-o", "x.html"), ".json"),
        (("design", "wall", "--c", "x.html"), ".h"),
        (("stiffness-map", "--csv", "x.html"), ".csv"),
        (("stiffness-map", "-o", "x.json"), ".html"),
        (("sweep", "dc-motor-hinf", "--csv", "x.html"), ".csv"),
        (("sweep", "dc-motor-hinf", "--grid", "plant.gain=150", "--csv", "x.html"), ".csv"),
        (("laws", "dc-motor-ours-busy-can", "--from-bus", "-o", "x.html"), ".toml"),
        (("identify", "law", "vcan-busy", "-o", "x.html"), ".toml"),
    ],
    ids=lambda found: found if isinstance(found, str) else " ".join(found[:2]),
)
def test_a_name_that_says_another_kind_of_file_is_refused_before_the_work(
    cli: Hil, hil_log: Path, tmp_path: Path, words: tuple[str, ...], ending: str
) -> None:
    status, out, err = cli(*(hil_log if word == "LOG" else word for word in words))
    assert (status, out) == (2, "") and f"is written here; expected a name that ends in {ending}" in err
    assert not os.listdir(tmp_path)


def test_a_log_and_a_design_of_python_are_named_as_those_of_a_command(tmp_path: Path) -> None:
    with pytest.raises(HilError, match=r"x\.html: a log is written here; expected a name that ends in \.mcap"):
        hil.run("dc-motor-hinf", duration=1, log=tmp_path / "x.html")


def test_a_design_overwrites_only_with_force(cli: Hil, tmp_path: Path) -> None:
    mine = tmp_path / "my.json"
    mine.write_text("mine")
    arguments = ("design", "dc-motor", "--information", "constant", "--starts", "1", "-o", "my.json")
    status, _, err = cli(*arguments)
    assert status == 2 and "--force" in err and mine.read_text() == "mine"
    assert cli(*arguments, "--force")[0] == 0 and '"hilrig-design/1"' in mine.read_text()
    assert cli(*arguments[:-1], "")[0] == 2


@pytest.mark.parametrize(
    ("command", "files"),
    [
        (["design", "wall", "--delay", "0", "-o", "wall.json", "--c", "wall.h"], ["wall.json", "wall.h"]),
        (["stiffness-map", "--period", "1ms", "--delay", "0", "--hand", "0", "-o", "map.html", "--csv", "map.csv"],
         ["map.html", "map.csv"]),
        (["can", "analyse", "t.csv", "--bitrate", "500k", "--duration", "0.1", "-o", "bus.html"], ["bus.html"]),
    ],
)  # fmt: skip
def test_a_command_says_what_it_has_written(cli: Hil, command: list[str], files: list[str]) -> None:
    Path("t.csv").write_text("name,can_id,period,length\nm,1,10 ms,8\n")
    status, out, _ = cli(*command)
    assert status == 0 and out.splitlines()[-len(files) :] == [f"written: {name}" for name in files]
    assert all(Path(name).stat().st_size for name in files)
    assert "written" not in cli(*command, "--force", "--json")[1]
