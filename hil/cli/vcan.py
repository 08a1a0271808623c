"""``hil vcan``: run a command where a real Linux vcan0 exists."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import click

from hil.cli.option_types import Duration
from hil.cli.terminal import visible


@click.command(context_settings={"allow_interspersed_args": False})
@click.option("--backend", type=click.Choice(["auto", "native", "uml", "debian"]), default="auto", show_default=True,
              help="This kernel's vcan, our user-mode kernel, or Debian's package of one.")  # fmt: skip
@click.option("--virtual-time", is_flag=True, help="The clock jumps to the next timer when all sleep (uml only).")
@click.option("--timeout", type=Duration(above=True), help="End COMMAND after that time, such as 90s.")
@click.option("--rw", multiple=True, metavar="DIR", type=click.Path(exists=True, file_okay=False, path_type=Path),
              help="One more directory in which files stay.")  # fmt: skip
@click.option("--source", metavar="FILE", type=click.Path(dir_okay=False, path_type=Path),
              help="Archive linux-6.12*.tar.xz to build the kernel from, in place of Debian's package.")  # fmt: skip
@click.option("--install", is_flag=True, help="Let Debian packages that a build lacks be installed (as root).")
@click.option("-v", "--verbose", is_flag=True, help="Say which kernel is used.")
@click.argument("argv", metavar="[--] COMMAND [ARG]...", nargs=-1, required=True, type=click.UNPROCESSED)
def command(
    backend: str, virtual_time: bool, timeout: float | None, rw: tuple[Path, ...], source: Path | None, install: bool,
    verbose: bool, argv: tuple[str, ...],
) -> None:  # fmt: skip
    """Run COMMAND where a real vcan0 exists, and exit with its status.

    Where this kernel has CAN, COMMAND has a network of its own with a vcan0 in it, and all else is as ever. Elsewhere, as in
    most containers, a small user-mode kernel is booted on this machine's own files (0.3 s). It is built once (some minutes) and
    kept in ~/.cache/hilrig. There, what COMMAND writes is thrown away, but in this directory and in those of --rw; /tmp is
    empty, HOME is another one, and only vcan0 and lo are networks. With --virtual-time computing takes no time: no deadline
    is missed however slow the machine is, and two runs give the same time stamps.

    \b
    Exit status: that of COMMAND (128 + N if signal N ended it)
      124  ended by --timeout
      125  no vcan0 could be had
      126, 127  COMMAND cannot be run, or is not there
    """
    from hil.vcan import RUNNER_FAILED, RunnerError, Wanted, run_beside_vcan
    from hil.vcan.supervise import say

    if virtual_time and backend not in ("auto", "uml"):
        raise click.UsageError(f"--backend {backend} has no virtual time")
    if source is not None and not source.is_file():
        raise click.BadParameter(f"there is no file {visible(source)}", param_hint="--source")
    wanted = Wanted(
        command=argv,
        backend=backend,
        virtual_time=virtual_time,
        writable=tuple(os.path.abspath(place) for place in (Path(), *rw)),
        source=None if source is None else source.absolute(),
        install=install,
        verbose=verbose,
    )
    try:
        status = run_beside_vcan(wanted, timeout)
    except RunnerError as why:
        say(str(why))
        status = RUNNER_FAILED
    sys.exit(status)
