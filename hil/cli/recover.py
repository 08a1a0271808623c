"""``hil recover``: a whole log from a torn one."""

from __future__ import annotations

from pathlib import Path

import click

from hil.cli.terminal import Working, visible


@click.command()
@click.argument("file", type=click.Path(path_type=Path))
@click.option("-o", "--output", type=click.Path(path_type=Path), help="File to write, FILE.recovered.mcap by default.")
def command(file: Path, output: Path | None) -> None:
    """Rebuild an indexed log from FILE, whose session was killed or whose disk was full.

    The command changes no existing file.
    """
    from hil.log.read.recover import recover

    target = output or Path(f"{str(file).removesuffix('.mcap')}.recovered.mcap")
    with Working(f"records of {file}"):
        found = recover(file, target).text
    print("\n".join(map(visible, found.splitlines())))
    print(f"written: {visible(target)}")
