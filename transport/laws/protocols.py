"""What a network law is: the seams between the laws, the impairment that applies them and whoever composes a run.

Two families. An *age law* says in every slot k that the newest usable packet is the one of slot k - age. A *packet
law* gives every packet its own latency, loss and duplicates. A law is a frozen set of parameters; `start` makes the
running process from it.
"""

from __future__ import annotations

from collections.abc import Callable
from os import PathLike
from typing import ClassVar, Literal, Protocol, TypeVar

import numpy as np

from transport.medium.draws import Draw


class AgeProcess(Protocol):
    """A running age law."""

    @property
    def draw(self) -> Callable[[], tuple[int, int]]:
        """Return (mode, age) of the next slot; to be called once per slot, from slot 0."""
        ...


class AgeFamily(Protocol):
    """Parameters of an age law, a plug-in of group `hil.laws`. An age that grows by one means: nothing newer came."""

    kind: ClassVar[str]
    family: ClassVar[Literal["age", "packet"]]

    @property
    def max_age(self) -> int:
        """Largest age in slots that `draw` can return."""
        ...

    def start(self, rng: np.random.Generator) -> AgeProcess:
        """Return a new process whose randomness is `rng` alone."""
        ...


class PacketProcess(Protocol):
    """A running packet law."""

    def draw(self, k: int) -> list[Draw]:
        """Return what becomes of the packet of slot k: one draw (sent or lost), and one more if it is copied."""
        ...


class PacketFamily(Protocol):
    """Parameters of a packet law, a plug-in of group `hil.laws`."""

    kind: ClassVar[str]
    family: ClassVar[Literal["age", "packet"]]

    @property
    def reordering(self) -> bool:
        """Whether a packet may overtake an earlier one; otherwise it waits for it."""
        ...

    @property
    def queue(self) -> int:
        """Largest number of packets in flight; one more is dropped and booked as overflow."""
        ...

    def start(self, rng: np.random.Generator, period_s: float, deadline_s: float) -> PacketProcess:
        """Return a new process for slots of `period_s` seconds that close `deadline_s` after they begin."""
        ...


_Law = TypeVar("_Law")


def load_files(law: _Law, directory: str | PathLike[str] | None = None) -> _Law:
    """Return the same law with the files that it names read: for whoever loads an experiment.

    Args:
        law: parameters of any network law; one without a method `loaded` names no files.
        directory: where relative file names start; the working directory by default.

    Raises:
        ValueError: a file is missing or faulty; the message starts with the field.
    """
    loaded = getattr(law, "loaded", None)
    return law if loaded is None else loaded(directory)


def prepare(law: _Law) -> _Law:
    """Return the same law with scipy.stats laws tabulated (and files read): for whoever composes a run.

    A prepared law needs neither the disk nor scipy.stats, so that it can be pickled into a process that keeps time. A
    law without a method `prepared` needs no preparation.
    """
    prepared = getattr(law, "prepared", None)
    return load_files(law) if prepared is None else prepared()


def slots_served(law: object) -> int | None:
    """Return for how many slots a law can draw, None for without end (a trace that does not repeat has an end)."""
    length: int | None = getattr(law, "length", None)
    return length
