"""What is asked of ``hil vcan``, checked."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True, kw_only=True)
class Wanted:
    """A command that wants a vcan0.

    Attributes:
        command: what to execute, with its arguments.
        backend: "native", "uml" or "debian"; "auto" takes the first that this machine has.
        virtual_time: the clock jumps to the next timer; only "uml" can.
        writable: absolute directories in which the command's files stay.
        source: archive of Linux 6.12 to build from in place of Debian's package.
        install: Debian packages that are missing may be installed.
        verbose: say which kernel is used.
    """

    command: tuple[str, ...]
    backend: str = "auto"
    virtual_time: bool = False
    writable: tuple[str, ...] = ()
    source: Path | None = None
    install: bool = False
    verbose: bool = False
