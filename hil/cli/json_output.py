"""`--json`: standard output holds one JSON value, whatever a plug-in prints meanwhile."""

from __future__ import annotations

import sys
from contextlib import redirect_stdout
from typing import TextIO

import click


def only_json(as_json: bool) -> TextIO:
    """Return where the JSON goes; with `--json` what else is printed until the command's end goes to standard error.

    Args:
        as_json: whether `--json` was given.
    """
    out = sys.stdout
    if as_json and sys.stderr is not None:
        click.get_current_context().with_resource(redirect_stdout(sys.stderr))
    return out
