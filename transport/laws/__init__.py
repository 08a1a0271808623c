"""The protocols of a network law: what the impairment that applies it, and the composition of a run, read of it.

Two families. An *age law* says in every slot k that the newest usable packet is the one of slot k - age. A *packet
law* gives every packet its own latency, loss and duplicates. A law is a frozen set of parameters; `start` makes the
running process from it.

What a law states beyond that decides what can be computed of it, ours or a user's: a `ChainLaw` or a `SemiMarkovLaw` gets a
certificate, a design and a prediction; these, a `RecordedLaw` and a `ChannelLaw` an analysis and a test of every record.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from os import PathLike
from typing import Any, ClassVar, Literal, Protocol, Self, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from transport.draws import Draw


class AgeProcess(Protocol):
    """A running age law."""

    @property
    def draw(self) -> Callable[[], tuple[int, int]]:
        """Return (mode, age) of the next slot; to be called once per slot, from slot 0."""


class AgeLaw(Protocol):
    """Parameters of an age law, a plug-in of group `hil.laws`. An age that grows by one means: nothing newer came."""

    kind: ClassVar[str]
    family: ClassVar[Literal["age", "packet"]]

    @property
    def max_age(self) -> int:
        """Largest age in slots that `draw` can return."""

    def start(self, rng: np.random.Generator) -> AgeProcess:
        """Return a new process whose randomness is `rng` alone."""


class PacketProcess(Protocol):
    """A running packet law."""

    def draw(self, k: int) -> list[Draw]:
        """Return what becomes of the packet of slot k: one draw (sent or lost), and one more if it is copied."""


class PerPacketLaw(Protocol):
    """Parameters of a packet law, a plug-in of group `hil.laws`; `transport.PacketLaw` is ours."""

    kind: ClassVar[str]
    family: ClassVar[Literal["age", "packet"]]

    @property
    def reordering(self) -> bool:
        """Whether a packet may overtake an earlier one; otherwise it waits for it."""

    @property
    def queue(self) -> int:
        """Largest number of packets in flight; one more is dropped and booked as overflow."""

    def start(self, rng: np.random.Generator, period_s: float, deadline_s: float) -> PacketProcess:
        """Return a new process for slots of `period_s` seconds that close `deadline_s` after they begin."""


NetworkLaw = AgeLaw | PerPacketLaw
"""What an experiment may name as the law of one direction."""


@runtime_checkable
class BoundedAge(Protocol):
    """A law that says how old the newest packet can be."""

    @property
    def max_age(self) -> int | None:
        """Largest age in slots; None for no bound."""


@runtime_checkable
class MarkovModes(Protocol):
    """A law whose modes are a Markov chain, whatever a mode means."""

    def transition_matrix(self) -> NDArray[np.float64]:
        """Return Pr(mode j in the next slot | mode i), (n, n)."""


@runtime_checkable
class ChainLaw(MarkovModes, Protocol):
    """An age law whose modes are a Markov chain, each with its age."""

    @property
    def mode_ages(self) -> Sequence[int]:
        """Age of every mode, in slots."""


@runtime_checkable
class AgeChain(ChainLaw, Protocol):
    """The chain of the age of the newest packet; of states of the largest age it says no more than that they are as old."""

    @property
    def bound(self) -> int:
        """Age in slots beyond which no packet comes any more."""

    @property
    def neglected(self) -> float:
        """Probability of a packet's latency that the chain leaves out; 0 where it is exact."""

    def initial_law(self) -> NDArray[np.float64]:
        """Return the law of the state in slot 0, (N,)."""


class Sojourn(Protocol):
    """Law of the time in slots, at least one, that a mode lasts."""

    def survival(self, slots: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return S(n) = Pr(h > n) for an array of n >= 0, same shape."""

    @property
    def support(self) -> int:
        """Largest sojourn time, or the one beyond which the probability is below 1e-12."""


@runtime_checkable
class BoundedTail(Protocol):
    """A sojourn law that says what its hazard does for ever; of one that does not say nothing is assumed."""

    def hazard_beyond(self, slots: int) -> tuple[float, float]:
        """Return the infimum and the supremum of Pr(h = n | h >= n) over all n > slots."""


@runtime_checkable
class SettlingHazard(Protocol):
    """A sojourn law that says where its hazard tends to, and that it never reaches 1 on the way."""

    def hazard_limit(self) -> float:
        """Return the limit of Pr(h = n | h >= n) as n grows."""


@runtime_checkable
class SemiMarkovLaw(Protocol):
    """An age law that stays in mode i for a time of its own law, and then goes to mode j with probability matrix[i][j]."""

    @property
    def mode_ages(self) -> Sequence[int]:
        """Age of every mode, in slots."""

    @property
    def matrix(self) -> Sequence[Sequence[float]]:
        """The embedded chain, (n, n)."""

    @property
    def sojourn(self) -> Sequence[Sojourn]:
        """One sojourn law per mode."""


@runtime_checkable
class RecordedLaw(Protocol):
    """An age law without chance: the mode is the age, and every one is known."""

    def recorded(self) -> NDArray[np.int64]:
        """Return the ages of slots 0, 1, ...; a law without end repeats them (see `FiniteLaw`)."""


@runtime_checkable
class ChannelLaw(MarkovModes, Protocol):
    """A packet law whose losses follow a Markov chain of the channel's modes, and whose latencies are independent of them."""

    latency: float | str | dict[str, Any]
    duplication: float
    queue: int
    reordering: bool
    discard_older: int | None
    loss_probability: float

    def channel_losses(self) -> Sequence[float]:
        """Return the loss probability in every mode, (n,)."""


@runtime_checkable
class PacketAges(Protocol):
    """A packet law whose ages may be a Markov chain, once the slots are known."""

    def age_chain(self, period_s: float, deadline_s: float, reach: int = 0) -> AgeChain:
        """Return the chain of the ages of the newest packet, those up to `reach` distinguished.

        Raises:
            NotKnown: there is none.
        """


@runtime_checkable
class PacketDelays(MarkovModes, Protocol):
    """A packet law that states how late each packet comes, for nodes that do not send in every slot."""

    @property
    def reordering(self) -> bool:
        """Whether a packet may overtake an earlier one; otherwise it waits for those that are not lost."""

    def delay_chances(self, period_s: float, deadline_s: float) -> NDArray[np.float64]:
        """Return Pr(a packet that the channel does not lose comes first j slots late), (J + 1,).

        Raises:
            NotKnown: nothing is known of it.
        """

    def channel_losses(self) -> Sequence[float]:
        """Return the probability that a packet is lost, in every mode of the channel."""

    def stationary(self) -> NDArray[np.float64]:
        """Return the law of the mode in slot 0, (modes,)."""


@runtime_checkable
class LongRunLaw(Protocol):
    """A law that says itself what it does in the long run."""

    def stationary(self) -> NDArray[np.float64]:
        """Return the share of slots in every mode, (n,)."""

    def mean_bursts(self) -> NDArray[np.float64]:
        """Return the mean number of slots that a mode lasts, (n,)."""


@runtime_checkable
class InitialLaw(Protocol):
    """A law that says in which mode it begins; one that does not is met in a long run."""

    @property
    def initial(self) -> str | Sequence[float]:
        """ "stationary" when slot 0 is met in a long run, else how the first mode is drawn."""

    def initial_law(self) -> NDArray[np.float64]:
        """Return the law of the mode in slot 0, (n,)."""


@runtime_checkable
class GapLaw(Protocol):
    """An age law that says whether its age may grow by more than one per slot; one that does not say may."""

    allow_gaps: bool


@runtime_checkable
class FiniteLaw(Protocol):
    """A law that may have nothing more to give."""

    @property
    def length(self) -> int | None:
        """Number of slots that the law serves, None for without end."""


@runtime_checkable
class FileLaw(Protocol):
    """A law that names files."""

    def loaded(self, directory: str | PathLike[str] | None = None) -> Self:
        """Return the same law with its files read."""


@runtime_checkable
class PreparedLaw(Protocol):
    """A law that tabulates what the processes that keep time shall not compute."""

    def prepared(self) -> Self:
        """Return the same law, tabulated, with its files read."""


_Law = TypeVar("_Law")


def load_files(law: _Law, directory: str | PathLike[str] | None = None) -> _Law:
    """Return the same law with the files that it names read, as when an experiment is loaded.

    Args:
        law: parameters of any network law; one without a method `loaded` names no files.
        directory: where relative file names start; the working directory by default.

    Raises:
        FieldError: a file is missing or faulty.
    """
    return law.loaded(directory) if isinstance(law, FileLaw) else law


def prepare(law: _Law) -> _Law:
    """Return the same law with scipy.stats laws tabulated (and files read), as when a run is composed.

    A prepared law needs neither the disk nor scipy.stats, so that it can be pickled into a process that keeps time. A
    law without a method `prepared` needs no preparation.
    """
    return law.prepared() if isinstance(law, PreparedLaw) else load_files(law)


def slots_served(law: object) -> int | None:
    """Return for how many slots a law can draw, None for without end (a trace that does not repeat has an end)."""
    return law.length if isinstance(law, FiniteLaw) else None
