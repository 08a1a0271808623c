"""``hil schema``: the JSON Schema of experiment files, with every installed plug-in in it."""

from __future__ import annotations

import json

import click


@click.command()
def command() -> None:
    """Print the JSON Schema of experiment files (for editors: put its path in the file's `#:schema` line)."""
    from hil.experiment.schema import experiment_schema

    print(json.dumps(experiment_schema(), indent=2))
