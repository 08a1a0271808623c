"""``hil layout``: a layout of Foxglove, Lichtblick or PlotJuggler for the topics of a log."""

from __future__ import annotations

from pathlib import Path

import click

from hil.cli.terminal import visible
from hil.log.topics import channels_of


@click.command()
@click.argument("viewer", type=click.Choice(["foxglove", "lichtblick", "plotjuggler"]))
@click.argument("source", metavar="SOURCE")
@click.option("-o", "--output", type=click.Path(path_type=Path), metavar="FILE", help="File to write; by default it is printed.")
@click.option("--force", is_flag=True, help="Replace a file that is there.")
def command(viewer: str, source: str, output: Path | None, force: bool) -> None:
    """Make a layout for the logs of SOURCE, an experiment or a log: outputs, states, inputs, delays, timing and events.

    Foxglove and Lichtblick import the JSON under "Import from file", PlotJuggler loads the XML by "Layout".
    """
    from hil.compose.loop import compose
    from hil.experiment import load_experiment
    from hil.files.outputs import check_output, write_output
    from hil.log.read.run import read_run
    from hil.pages.layouts import foxglove, plotjuggler

    if output is not None:
        check_output(output, fresh=not force, remedy="choose another -o or add --force")
    if Path(source).suffix == ".mcap":
        schemas = read_run(source).schemas
    else:
        loop = compose(load_experiment(source), certify=False)
        schemas = {topic: channel.schema for topic, channel in channels_of(loop).items()}
    text = plotjuggler(schemas) if viewer == "plotjuggler" else foxglove(schemas) + "\n"
    if output is None:
        click.echo(text, nl=False)
    else:
        write_output(output, text, replace=force)
        click.echo(f"written: {visible(output)}")
