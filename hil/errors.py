"""The one error root of ``hil``; the command line turns it into a message and an exit status."""

from __future__ import annotations


class HilError(Exception):
    """Something the user can mend; the message names the object, the value and what was expected.

    Attributes:
        status: exit status on the command line.
    """

    status = 2


class DiskFull(HilError):
    """A disk that took not one record of a run; the command and its files are correct."""

    status = 1


class ExperimentError(HilError):
    """An experiment that cannot be run, with every fault that was found.

    Args:
        source: file or name of the experiment.
        faults: one line each, ``path.of.the.field: what is wrong``.
    """

    def __init__(self, source: str, faults: list[str]) -> None:
        self.source = source
        self.faults = faults
        super().__init__("\n".join(f"{source}: {fault}" for fault in faults))


class ForeignVerdict(Exception):
    """A verdict whose digest is not that of the loop it is shown for: a fault of the program, never of the user."""
