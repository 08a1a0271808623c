"""`--json`: standard output holds one JSON value, whatever a module, its C code or its children print meanwhile."""

from __future__ import annotations

import io
import json
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from typing import Any, Final, TextIO, TypeVar

import click

_OUT: Final = "hil.cli.json_output"
_Command = TypeVar("_Command", bound=Callable[..., Any])


def json_option(help: str = "Print one JSON object.") -> Callable[[_Command], _Command]:
    """Return the option `--json` of a command, its parameter `as_json`; what else is printed goes to standard error.

    Args:
        help: what ``--help`` says of it.
    """
    return click.option("--json", "as_json", is_flag=True, is_eager=True, callback=_only_json, help=help)


def print_json(value: object) -> None:
    """Print the one JSON value of a command."""
    out = click.get_current_context().meta.get(_OUT, sys.stdout)
    print(json.dumps(value, indent=2), file=out, flush=True)


def _only_json(context: click.Context, _option: click.Parameter, as_json: bool) -> bool:
    if as_json and not context.resilient_parsing:
        context.meta[_OUT] = context.with_resource(_stdout_to_stderr())
    return as_json


@contextmanager
def _stdout_to_stderr() -> Iterator[TextIO]:
    """Yield where standard output went until now; for so long it goes to standard error, the descriptor too."""
    out = sys.stdout
    with open(os.devnull, "w") as nowhere, redirect_stdout(sys.stderr or nowhere):
        if not _is_descriptor(out, 1):  # a test or a notebook took its place
            yield out
            return
        out.flush()
        kept = os.dup(1)
        os.dup2(2 if _is_descriptor(sys.stderr, 2) else nowhere.fileno(), 1)
        try:
            with open(kept, "w", encoding=out.encoding, errors=out.errors, closefd=False) as file:
                yield file
        finally:
            with suppress(OSError):
                os.dup2(kept, 1)
            with suppress(OSError):
                os.close(kept)


def _is_descriptor(stream: TextIO | None, number: int) -> bool:
    try:
        return stream is not None and stream.fileno() == number
    except (io.UnsupportedOperation, ValueError):  # no file, or closed
        return False
