"""The option that serves a run to Foxglove, too."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from hil.session import Onlooker

foxglove_option = click.option(
    "--foxglove", type=click.IntRange(0, 65535), is_flag=False, flag_value=8765, metavar="[PORT]",
    help="Serve the records to Foxglove or Lichtblick, too, over its WebSocket protocol on 127.0.0.1 (port 8765).",
)  # fmt: skip


@contextmanager
def foxglove_beside(onlooker: Onlooker | None, port: int | None) -> Iterator[Onlooker | None]:
    """Give an onlooker with Foxglove beside it, or it alone where no port is asked for.

    Raises:
        HilError: see `hil.pages.live.foxglove.Foxglove`.
    """
    if port is None:
        yield onlooker
        return
    from hil.pages.live.foxglove import Beside, Foxglove

    with Foxglove(port) as server:
        click.echo(f"Foxglove: open connection {server.url}", err=True)
        yield server if onlooker is None else Beside(onlooker, server)
