"""``hil report``, ``hil recover``, ``hil export``, ``hil layout``: what is made of a log."""

from __future__ import annotations

from pathlib import Path

import click

from hil.cli.terminal import Working, print_each_folded, visible
from hil.errors import HilError


@click.command()
@click.argument("file", type=click.Path())
@click.option("-o", "--output", type=click.Path(path_type=Path), metavar="PAGE.html", help="Page to write, FILE.html by default.")
@click.option("--figures", type=click.Path(path_type=Path), metavar="DIR", help="Also write every plot as SVG and PDF.")
@click.option("--folder", type=click.Path(path_type=Path), metavar="DIR", help="Where own modules stand: they are run.")
@click.option("--open", "show", is_flag=True, help="Open the page in the browser.")
@click.option("--force", is_flag=True, help="Replace a file that is there; a page always is.")
def report(file: str, output: Path | None, figures: Path | None, folder: Path | None, show: bool, force: bool) -> None:
    """Make one self-contained HTML page from the log FILE: it needs no network and no other file.

    Where FILE is a folder, its page (index.html) lists all its logs, with a filter and their outputs; each gets its own page.

    A page that is there is replaced; the log is never changed.
    """
    from hil.api.face import report

    if not file:
        raise HilError("FILE: the name is empty; is a variable of the shell not set? `hil report .` is this folder")
    with Working(f"page of {file}"):
        page, *drawn = report(file, output=output, force=force, figures=figures, folder=folder)
    click.echo(f"written: {visible(page)} ({page.stat().st_size / 1e6:.1f} MB)")
    if Path(file).is_dir():
        click.echo(f"written: {len(drawn)} page{'s' * (len(drawn) != 1)} of runs beside it")
    if figures is not None:
        click.echo(f"written: {len(drawn)} figures in {visible(figures)}")
    if show:
        click.launch(str(page))


@click.command()
@click.argument("file", type=click.Path(path_type=Path))
@click.option("-o", "--output", type=click.Path(path_type=Path), help="File to write, FILE.recovered.mcap by default.")
def recover(file: Path, output: Path | None) -> None:
    """Rebuild an indexed log from FILE, whose session was killed or whose disk was full.

    The command changes no existing file.
    """
    from hil.log.read.recover import recover

    target = output or Path(f"{str(file).removesuffix('.mcap')}.recovered.mcap")
    with Working(f"records of {file}"):
        found = recover(file, target).text
    print_each_folded(found.splitlines())
    print(f"written: {visible(target)}")


@click.command()
@click.argument("file", type=click.Path(path_type=Path))
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), required=True, help="Ends in .log, .blf, .asc, .trc, .mf4, .csv or .npz."
)
@click.option("--topic", "topics", multiple=True, metavar="TOPIC", help="Only this topic; may be given more than once.")
@click.option("--force", is_flag=True, help="Replace files that are there.")
def export(file: Path, output: Path, topics: tuple[str, ...], force: bool) -> None:
    """Write the log FILE as a CAN log (candump .log, Vector .blf or .asc, PEAK .trc, ASAM .mf4) or as tables (.csv, .npz).

    Frames stand at their measured times, tables have session times. Tables of more than one topic become files named
    OUTPUT.topic.csv. A run with an emulated CAN bus gives the frames of that bus: the log knows their times and lengths, their
    bytes are 00; --topic /link/sensor and --topic /link/control give those of the link.
    """
    from hil.files import check_output
    from hil.log.read.export import export
    from hil.log.read.run import read_run

    check_output(output, fresh=not force, remedy="choose another -o or add --force")
    with Working(f"export of {file}"):
        written = list(export(read_run(file), output, topics, replace=force))
    for path in written:
        print(visible(path))


@click.command()
@click.argument("viewer", type=click.Choice(["foxglove", "lichtblick", "plotjuggler"]))
@click.argument("source", metavar="SOURCE")
@click.option("-o", "--output", type=click.Path(path_type=Path), metavar="FILE", help="File to write; by default it is printed.")
@click.option("--force", is_flag=True, help="Replace a file that is there.")
def layout(viewer: str, source: str, output: Path | None, force: bool) -> None:
    """Make a layout for the logs of SOURCE, an experiment or a log: outputs, states, inputs, delays, timing and events.

    Foxglove and Lichtblick import the JSON under "Import from file", PlotJuggler loads the XML by "Layout".
    """
    from hil.compose.loop import compose
    from hil.experiment import load_experiment
    from hil.files import check_output, write_output
    from hil.log.read.run import read_run
    from hil.log.topics import channels_of
    from hil.pages.viewers import foxglove, plotjuggler

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
