"""Every option of the commands that compute, with unexpected words: a status of ours, one message, no traceback.

The words go through a shell's door, ``hil`` itself in a process of its own, so that warnings and stray output count as well.
"""

from __future__ import annotations

import os
import stat
from contextlib import suppress
from pathlib import Path
from random import Random

import click
import pytest

from hil.cli import cli
from tests.hostile.logs import our_log
from tests.warm_hil import hil_command

FEW = 6
PARTS = 4
PATIENCE_S = 120.0

WORDS = (
    "-1", "0", "1e308", "nan", "inf", "-inf", "9" * 20, "1e-300", "", "x", "[1]", "\x1b[2J", "a=b", "=", "../x", "device", "/",
    "/proc/self/mem", "a\nb", "b/" * 3000,
)  # fmt: skip
COMMANDS: dict[str, tuple[str, ...]] = {
    "run": ("dc-motor-hinf", "--duration", "0.2", "--quiet", "--force", "-o", "o.mcap"),
    "sweep": ("dc-motor-hinf", "--runs", "3", "--set", "duration=0.5 s"),
    "compare": ("dc-motor-hinf", "dc-motor-h2", "--runs", "3", "--set", "duration=0.5 s"),
    "replay": ("r.mcap",),
    "report": ("r.mcap", "-o", "report.html"),
    "export": ("r.mcap",),
    "recover": ("r.mcap", "-o", "recovered.mcap"),
    "layout": ("r.mcap",),
    "design": ("dc-motor-ours-h2",),
    "identify": ("r.mcap",),
    "laws": ("dc-motor-hinf",),
    "dbc": ("dc-motor-two-nodes",),
    "schema": (),
    "guide": (),
}
STATUSES = range(7)
"""Of `hil run --help`; 1 also says that something looked for was not found."""

Words = tuple[str, ...]


def _inputs() -> list[Words]:
    """Every option with every word, and every word in the place of the first argument."""
    found: list[Words] = []
    with click.Context(cli) as context:
        for name, rest in COMMANDS.items():
            command = cli.get_command(context, name)
            assert command is not None
            for parameter in command.params:
                if isinstance(parameter, click.Option) and not parameter.is_eager:
                    said = [()] if parameter.is_flag else [(word,) for word in WORDS]
                    found += [(name, *rest, parameter.opts[-1], *words) for words in said]
            found += [(name, word, *rest[1:]) for word in WORDS if rest]
    return found


def _attack(given: list[Words], folder: Path) -> None:
    (folder / "r.mcap").write_bytes(our_log())
    device = folder / "device"  # as /dev/full; that of the machine is not put at risk
    with suppress(PermissionError):
        os.mknod(device, stat.S_IFCHR | 0o666, os.makedev(1, 7))
    before = device.exists()
    bad = []
    environment = {**os.environ, "XDG_CACHE_HOME": str(folder / "cache"), "OMP_NUM_THREADS": "1"}
    for words in given:
        done = hil_command(*words, cwd=folder, env=environment, timeout=PATIENCE_S)
        if done.returncode not in STATUSES or any(word in done.stderr for word in ("Traceback", "Warning", "Exception ignored")):
            bad.append(f"hil {words} ended with {done.returncode}: {done.stderr[-1500:]}")
        if before and not device.is_char_device():
            bad.append(f"hil {words} put something in the place of a device")
            device.unlink(missing_ok=True)
            os.mknod(device, stat.S_IFCHR | 0o666, os.makedev(1, 7))
    assert not bad, "\n\n".join(bad)


def test_an_unusual_word_gets_one_message(tmp_path: Path) -> None:
    _attack(Random(15).sample(_inputs(), FEW), tmp_path)


@pytest.mark.hostile
@pytest.mark.parametrize("part", range(PARTS))
def test_every_option_with_every_word_gets_one_message(part: int, tmp_path: Path) -> None:
    _attack(_inputs()[part::PARTS], tmp_path)


@pytest.mark.parametrize(
    "words",
    [
        ("compare", "dc-motor-hinf", "dc-motor-h2", "--runs", "9" * 20),
        ("design", "dc-motor-ours-h2", "--starts", "9" * 20),
        ("design", "dc-motor-ours-h2", "--gain-bound", "1e308"),
        ("design", "dc-motor-ours-h2", "--integral", "1e308"),
        ("run", "dc-motor-hinf", "--duration", "0.2", "--quiet", "-o", "b/" * 3000),
        ("report", "b" * 3000 + ".mcap"),
    ],
)
def test_what_once_failed(words: Words, tmp_path: Path) -> None:
    _attack([words], tmp_path)
