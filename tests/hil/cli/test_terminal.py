"""Foreign names, keys and paths on a terminal are shown, never obeyed; a message never floods it."""

from __future__ import annotations

import os
import pty
import random
import re
import subprocess
import sys
from contextlib import suppress
from itertools import product
from pathlib import Path
from threading import Thread

import pytest

from hil.cli.page_text import print_table
from hil.cli.terminal import LONGEST, message_lines, visible
from hil.experiment import shipped
from hil.pages import Badge, Cell, Table
from tests.hil.cli.conftest import Hil
from tests.warm_hil import hil_command

GOOD = shipped()["dc-motor-hinf"].read_text()


CHARACTERS = "".join(map(chr, (*range(0x3000), *range(0xD7F0, 0xE010), *range(0xE000, 0x10FFFF, 0x1001), 0x10FFFF)))
"""Of every category."""


def test_nothing_that_moves_a_cursor_gets_through() -> None:
    shown = visible(CHARACTERS)
    assert not any(ord(c) < 32 or 127 <= ord(c) < 160 or c in "\u2028\u2029\u202e" for c in shown)
    assert visible(shown) == shown


def test_a_message_has_at_most_2_kB_and_says_what_it_left_out() -> None:
    rng = random.Random(0)
    for _ in range(100):
        lines = ["".join(rng.choices(CHARACTERS, k=rng.randrange(40))) for _ in range(rng.randrange(1, 50))]
        shown = message_lines("\n".join(lines) + "x" * rng.choice((0, rng.randrange(20_000))))
        assert sum(len(f"hil: {line}\n".encode()) for line in shown) <= LONGEST


@pytest.mark.parametrize("columns", [20, 40, 60, 80, 200])
def test_a_table_that_folds_loses_no_word(
    columns: int, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    numbers: list[list[Cell]] = [[1000.0 + i, 0.44, f"w{i}", ", ".join(f"SAE{i}{j}" for j in range(3))] for i in range(9)]
    print_table(Table(columns=["deadline ms", "measured ms", "in time", "delayed by"], rows=numbers), folds=True)
    shown = capsys.readouterr().out
    words = [str(one) for row in numbers for cell in row for one in str(cell).replace(",", " ").replace(".0", "").split()]
    assert [word for word in words if word not in shown] == []
    assert max(map(len, shown.splitlines())) <= max(columns, 55)


LINKS = ("list", "links")
COLOURED = [("laws", "dc-motor-hinf"), LINKS, ("guide", "glossary")]


@pytest.mark.parametrize(
    ("arguments", "plain"),
    [*product(COLOURED, ({"NO_COLOR": "1"}, {})), (LINKS, {"TERM": "dumb"})],
    ids=lambda each: each[0] if isinstance(each, tuple) else "".join(each) or "colour",
)
def test_no_color_or_a_dumb_terminal_is_no_escape_code(tmp_path: Path, arguments: tuple[str, ...], plain: dict[str, str]) -> None:
    environment = {k: v for k, v in os.environ.items() if k != "NO_COLOR"} | {"TERM": "xterm", "PAGER": "cat", "COLUMNS": "80"}
    ours, theirs = pty.openpty()
    shown: list[bytes] = []

    def keep() -> None:
        with suppress(OSError):  # the end of a pseudo terminal
            while part := os.read(ours, 65536):
                shown.append(part)

    reader = Thread(target=keep)
    reader.start()
    environment |= plain
    done = hil_command(*arguments, cwd=tmp_path, env=environment, terminal=os.ttyname(theirs))
    os.close(theirs)
    reader.join()
    os.close(ours)
    assert done.returncode == 0 and len(b"".join(shown)) > 300
    assert (b"\x1b[" in b"".join(shown)) is not bool(plain)


@pytest.mark.parametrize("words", [
    ("identify", "law", "LOG"), ("replay", "LOG", "--controller", "h2"), ("recover", "LOG", "-o", "new.mcap"),
    ("check", "plants", "dc-motor"), ("laws", "dc-motor-packets"), ("sweep", "vtol-h2", "--runs", "4", "--until", "sse=0.1"),
    ("show", "nosuch"),
], ids=lambda words: words[0])  # fmt: skip
def test_prose_is_folded_at_the_terminals_columns(
    cli: Hil, hil_log: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...]
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    _, out, _ = cli(*(str(hil_log) if word == "LOG" else word for word in words))
    prose = [line for line in out.splitlines() if not re.match(r"(latency|matrix) = |.*\.mcap", line)]  # for a file, and paths
    assert max(map(len, prose), default=0) <= 80


def test_what_another_controller_would_have_commanded_has_its_unit(cli: Hil, hil_log: Path) -> None:
    out = " ".join(cli("replay", str(hil_log), "--controller", "h2")[1].split())
    assert re.search(r"voltage: h2 would have differed by \S+ V rms, \S+ V at most \(largest command \S+ V, recorded", out)


def test_the_title_of_a_narrow_table_is_not_folded_at_its_columns(capsys: pytest.CaptureFixture[str]) -> None:
    print_table(Table(title="gains K[tau][row], row by 'applied'", columns=["tau"], rows=[[1]]))
    assert "gains K[tau][row], row by 'applied'\n" in capsys.readouterr().out


def test_a_number_on_the_terminal_can_be_pasted(capsys: pytest.CaptureFixture[str]) -> None:
    row: list[Cell] = [-0.5, 2.5e-9, -1234567, "−2 to 1e-07", Badge(label="p = −1", state="bad")]
    print_table(Table(columns=list("abcde"), rows=[row]))
    assert " ".join(capsys.readouterr().out.split()).endswith("-0.5 2.50000e-9 -1234567 -2 to 1e-07 p = -1")


def test_a_short_message_is_left_alone() -> None:
    assert message_lines("period: missing\nname: missing") == ["period: missing", "name: missing"]
    assert message_lines("\n".join(["x" * 500] * 10))[-1] == "... and 7 more of these"


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('name = "dc-motor-hinf"', 'name = "a\\u001b]0;title\\u0007\\u001b[2J"'),
        ("seed = 0", '"\\u001b[2Jseed" = 0'),
        ('kind = "hinf"', 'kind = "\\u001b[2Jhinf"'),
    ],
    ids=["name", "key", "value"],
)
def test_an_experiment_cannot_write_to_the_terminal(cli: Hil, tmp_path: Path, old: str, new: str) -> None:
    (tmp_path / "x.toml").write_text(GOOD.replace(old, new))
    status, out, err = cli("run", "x.toml")
    assert (status, out) == (2, "") and "\x1b" not in err and "x1b" in err and "Traceback" not in err


@pytest.mark.parametrize("command", [("controller",), ("rig",), ("run", "--clock", "real")])
def test_a_link_of_an_experiment_cannot_write_to_the_terminal(cli: Hil, tmp_path: Path, command: tuple[str, ...]) -> None:
    (tmp_path / "x.toml").write_text(GOOD + '\n[links]\nuri = "zenoh:?name=a\\u001b[2Jb"\n')
    status, out, err = cli(command[0], "x.toml", *command[1:])
    assert (status, out) == (2, "") and "\x1b" not in err and "x1b" in err


def test_a_message_is_not_as_long_as_its_input(cli: Hil, tmp_path: Path) -> None:
    (tmp_path / "x.toml").write_text("\n".join(f"key_{i} = 1" for i in range(5_000)))
    status, _, err = cli("run", "x.toml")
    assert status == 2 and len(err.encode()) <= LONGEST and "more of these" in err


@pytest.mark.parametrize("name", ["x[bold]y.mcap", "x[/].mcap", "x\x1b[2Jy.mcap"])
def test_a_log_with_markup_in_its_name_is_reported_under_its_name(cli: Hil, tmp_path: Path, name: str) -> None:
    status, out, err = cli("run", "dc-motor-hinf", "--duration", "1 s", "-o", name)
    assert (status, err) == (0, "") and visible(name) in out.replace("\n", "") and "\x1b" not in out
    assert (tmp_path / name).stat().st_size > 0


def test_a_log_is_its_users_alone_unless_asked_otherwise(cli: Hil, tmp_path: Path) -> None:
    cli("run", "dc-motor-hinf", "--duration", "1 s", "-o", "a.mcap")
    cli("run", "dc-motor-hinf", "--duration", "1 s", "-o", "b.mcap", "--log-mode", "644")
    (tmp_path / "c.mcap").touch(mode=0o644)
    cli("run", "dc-motor-hinf", "--duration", "1 s", "-o", "c.mcap", "--force")
    assert [(tmp_path / f"{n}.mcap").stat().st_mode & 0o777 for n in "abc"] == [0o600, 0o644, 0o600]
    status, _, err = cli("run", "dc-motor-hinf", "--log-mode", "477")
    assert status == 2 and "--log-mode" in err


@pytest.mark.parametrize(
    "asked",
    [
        "can analyse dc-motor-busy-can --duration 1",
        "laws dc-motor-wifi",
        "problems",
        "sweep dc-motor-hinf --runs 2 --duration 5",
        "list",
    ],
)
def test_what_is_printed_stays_within_80_columns(cli: Hil, asked: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    status, out, _ = cli(*asked.split())
    assert status == 0
    assert [line for line in out.splitlines() if len(line.rstrip()) > 80] == []


@pytest.mark.parametrize("group", ["bench", "can", "completion", "identify", "keys"])
def test_the_help_of_a_group_cuts_no_sentence(cli: Hil, group: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    status, out, _ = cli(group, "--help")
    assert status == 0 and "..." not in out.replace("[ARGS]...", "") and max(map(len, out.splitlines())) <= 80


def test_a_locale_without_a_sign_of_ours_ends_no_command(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("name,can_id,length,period\nfront\u2013rear,0x12,2,9 ms\n", "utf-8")
    words = [sys.executable, "-m", "hil", "can", "analyse", "t.csv", "--bitrate", "500k"]
    environment = {**os.environ, "PYTHONIOENCODING": "ascii", "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(words, capture_output=True, cwd=tmp_path, env=environment, timeout=120)
    assert done.returncode == 0 and rb"front\u2013rear" in done.stdout, done.stderr
