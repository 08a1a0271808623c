"""``hil rig``: the rig of an experiment alone, for a controller that runs elsewhere."""

from __future__ import annotations

from pathlib import Path

import click

from hil.cli.completion import CHANGE, EXPERIMENT
from hil.cli.option_types import Duration
from hil.cli.terminal import json_option


@click.command()
@click.argument("experiment", type=EXPERIMENT)
@click.option("--link", metavar="URI", help="Link to the controller; the experiment's own by default.")
@click.option("--set", "sets", type=CHANGE, multiple=True, metavar="PATH=VALUE", help="Change a field, such as plant.gain=170.")
@click.option("--seed", type=int, help="Seed of the run; the experiment's own by default.")
@click.option("--duration", type=str, metavar="S", help="Length of the run: 10, 10s, 2min.")
@click.option("-o", "--output", type=click.Path(path_type=Path), metavar="FILE.mcap", help="Log; by default below runs/.")
@click.option("--force", is_flag=True, help="Replace a log that is there.")
@click.option("--wait", type=Duration(), help="How long to wait for a controller; until Ctrl-C by default.")
@json_option("Print the summary as one JSON object.")
@click.option("--quiet", is_flag=True, help="No live view.")
@click.pass_context
def command(ctx: click.Context, /, experiment: str, wait: float | None, **options: object) -> None:
    """Run the rig of EXPERIMENT alone, in real time, and wait for a controller on the link.

    The controller is `hil controller EXPERIMENT` elsewhere, or a program of your own: hil new controller NAME --language python
    --for EXPERIMENT. The same as `hil run --clock real --external` with all the time that it takes.
    """
    from hil.cli.run import LONGEST_WAIT_S, command

    wait = LONGEST_WAIT_S if wait is None else wait
    ctx.invoke(command, experiment=experiment, clock="real", external=True, wait=wait, **options)
