"""``hil export``: a log in the formats of other tools."""

from __future__ import annotations

from pathlib import Path

import click

from hil.cli.terminal import Working, visible


@click.command()
@click.argument("file", type=click.Path(path_type=Path))
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), required=True, help="Ends in .log, .blf, .asc, .trc, .csv or .npz."
)
@click.option("--topic", "topics", multiple=True, metavar="TOPIC", help="Only this topic; may be given more than once.")
@click.option("--force", is_flag=True, help="Replace files that are there.")
def command(file: Path, output: Path, topics: tuple[str, ...], force: bool) -> None:
    """Write the log FILE as a CAN log (candump .log, Vector .blf or .asc, PEAK .trc) or as tables (.csv, .npz).

    Frames stand at their measured times, tables have session times. Tables of more than one topic become files named
    OUTPUT.topic.csv.
    """
    from hil.files.outputs import check_output
    from hil.log.read.export import export
    from hil.log.read.run import read_run

    check_output(output, fresh=not force, remedy="choose another -o or add --force")
    with Working(f"export of {file}"):
        written = list(export(read_run(file), output, topics, replace=force))
    for path in written:
        print(visible(path))
