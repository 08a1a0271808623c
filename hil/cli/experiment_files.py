"""``hil show``, ``hil schema``, ``hil solve``: the file of an experiment, and the gains that stand beside it."""

from __future__ import annotations

import json

import click

from hil.cli.completion import EXPERIMENT
from hil.cli.terminal import Working
from hil.errors import HilError


@click.command()
@click.argument("experiment", type=EXPERIMENT)
def show(experiment: str) -> None:
    """Print the file of a shipped EXPERIMENT: hil show dc-motor-hinf > mine.toml"""
    from hil.experiment.load import near_shipped, shipped

    found = shipped()
    if experiment not in found:
        hint = near_shipped(experiment) or ";"
        raise HilError(f"no shipped experiment {experiment!r:.80}{hint} `hil list` shows them")
    print(found[experiment].read_text(encoding="utf-8"), end="")


@click.command()
def schema() -> None:
    """Print the JSON Schema of experiment files (for editors: put its path in the file's `#:schema` line)."""
    from hil.experiment.schema import experiment_schema

    print(json.dumps(experiment_schema(), indent=2))


@click.command()
@click.argument("experiments", metavar="EXPERIMENT...", nargs=-1, required=True)
def solve(experiments: tuple[str, ...]) -> None:
    """Solve the gains of every EXPERIMENT and store them in gains/NAME.json beside its file.

    What is solved differs from machine to machine in its last digits. With the file beside it an experiment has the same
    bits on every machine. The file holds the digest of its problem: after a change of plant, network or request the
    gains are solved where they run, the summary says so, and this command stores them anew.

    Exit status 2 where an experiment asks for no design, or no gains meet its request.
    """
    from hil.compose.loop import solved_gains
    from hil.compose.stored_gains import gains_file, gains_text
    from hil.experiment import load_experiment
    from hil.files.outputs import made_folder, write_output

    for name in experiments:
        experiment = load_experiment(name)
        with Working(f"gains of {experiment.name}"):
            found = solved_gains(experiment)
        if found is None:
            raise HilError(f"{name}: its gains are given; there is nothing to solve")
        path = gains_file(experiment)
        made_folder(path.parent)
        write_output(path, gains_text(experiment, *found), replace=True)
        print(f"{path}: gains of {experiment.name} ({found[0].kind})")
