"""Every option that takes a time takes it as an experiment file does."""

from __future__ import annotations

import click
import pytest

from hil.cli import COMMANDS, command_of
from hil.cli.option_types import Duration, NumberList
from tests.hil.cli.conftest import Hil

TIMES = {"--duration", "--for", "--wait", "--timeout", "--period"}


def options(command: click.Command, at: str) -> list[tuple[str, click.Parameter]]:
    """Return every option of a command and of those below it."""
    found = [(f"{at} {name}", p) for p in command.params for name in p.opts]
    for name, below in getattr(command, "commands", {}).items():
        found += options(below, f"{at} {name}")
    return found


TEXT = tuple(f"{name} --duration" for name in ("run", "rig", "live", "sweep", "compare"))


def test_every_time_is_a_duration() -> None:
    """`--duration` of run, rig, live, sweep and compare is text, for it goes to the experiment, which reads it the same way."""
    for name in COMMANDS:
        for at, option in options(command_of(name), name):
            if at.rpartition(" ")[2] in TIMES and at != "new --for":  # an experiment
                times = option.type._number.__name__ == "in_seconds" if isinstance(option.type, NumberList) else None
                assert isinstance(option.type, Duration) or times or at in TEXT, at


@pytest.mark.parametrize("duration", ["1s", "1000ms", "1 s", "1.", "1e3ms"])
def test_a_run_lasts_as_long_as_is_typed(cli: Hil, duration: str) -> None:
    status, out, err = cli("run", "dc-motor-hinf", "--duration", duration, "--set", "period=25ms", "--quiet", "-o", "a.mcap")
    assert (status, err) == (0, "") and "40" in out


@pytest.mark.parametrize(
    ("value", "says"),
    [("2 parsec", "'2 parsec' is not a duration"), ("0s", "a duration above 0 s"), ("-1s", "above 0 s"), ("1e999", "inf")],
)
def test_an_option_says_what_is_no_duration(value: str, says: str) -> None:
    with pytest.raises(click.BadParameter, match=says):
        Duration(above=True).convert(value, None, None)


def test_lists_of_times_have_units_too() -> None:
    assert NumberList(above=True, times=True).convert("1ms,0.05,2 s", None, None) == (0.001, 0.05, 2.0)
