"""``hil show``: the file of an experiment that comes with the package, to read or to start from."""

from __future__ import annotations

import click

from hil.cli.completion import EXPERIMENT


@click.command()
@click.argument("experiment", type=EXPERIMENT)
def command(experiment: str) -> None:
    """Print the file of a shipped EXPERIMENT: hil show dc-motor-hinf > mine.toml"""
    from hil.errors import HilError, nearest
    from hil.experiment import shipped

    found = shipped()
    if experiment not in found:
        hint = nearest(experiment, found, cutoff=0.4) or ";"
        raise HilError(f"no shipped experiment {experiment!r:.80}{hint} `hil list` shows them")
    print(found[experiment].read_text(encoding="utf-8"), end="")
