"""``hil show``: the file of an experiment that comes with the package, to read or to start from."""

from __future__ import annotations

import click

from hil.cli.completion import EXPERIMENT


@click.command()
@click.argument("experiment", type=EXPERIMENT)
def command(experiment: str) -> None:
    """Print the file of a shipped EXPERIMENT: hil show dc-motor-hinf > mine.toml"""
    import difflib

    from hil.errors import HilError
    from hil.experiment import shipped

    found = shipped()
    if experiment not in found:
        near = difflib.get_close_matches(experiment, found, n=1, cutoff=0.4)
        hint = f"did you mean {near[0]!r}? " if near else ""
        raise HilError(f"no shipped experiment {experiment!r:.80}; {hint}`hil list` shows them")
    print(found[experiment].read_text(encoding="utf-8"), end="")
