"""What a receiver makes of a packet law: the chain of the ages that it measures, and what it does beyond the largest it knows.

Beyond `max_age` the controller keeps the newest sample, and takes the gains of the largest delay; the actuator has no row, and
holds the input that it applied before.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from msgspec import Struct

from transport.laws import AgeChain, NetworkLaw, PacketAges
from transport.laws.delay_states import DelayStates, delay_states

if TYPE_CHECKING:
    from design.processes.delay_chain import DelayChain


class Receiver(NamedTuple):
    """Who receives: when slots close (s), the largest age that it has rows or gains for, and whether it holds an input."""

    period_s: float
    deadline_s: float
    max_age: int
    holds_input: bool


def ages_of(law: NetworkLaw, at: Receiver) -> NetworkLaw | AgeChain:
    """Return the chain of the ages at a receiver under a packet law that has one, any other law as it is."""
    found = law.age_chain(at.period_s, at.deadline_s, at.max_age) if isinstance(law, PacketAges) else law
    return law if isinstance(found, str) else found


def delays_of(chain: AgeChain, at: Receiver) -> DelayChain:
    """Return the delay chain of the ages at a receiver."""
    from design.processes.delay_chain import DelayChain

    ages = np.array(chain.mode_ages, dtype=np.int64)
    oldest = at.max_age if at.holds_input else max(at.max_age, chain.bound)
    return DelayChain(
        transition=chain.transition_matrix(), delays=np.minimum(ages, oldest), labels=np.minimum(ages, at.max_age),
        held=ages > oldest,
    )  # fmt: skip


def why_no_ages(law: NetworkLaw, at: Receiver) -> str:
    """Return why a law states no chain, in words."""
    said = law.age_chain(at.period_s, at.deadline_s, at.max_age) if isinstance(law, PacketAges) else ""
    return f"states no chain: {said}" if isinstance(said, str) and said else "states no chain: it is a packet law or a trace"


class Received(Struct, frozen=True, kw_only=True):
    """A network law as its receiver meets it.

    Args:
        path: of the law's table, for messages.
        law: the law.
        at: who receives.
        ages: the chain of the ages at the receiver under a packet law that has one, any other law as it is.
        states: the chain of the measured age, None where there is none; see `transport.laws.delay_states`.
    """

    path: str
    law: NetworkLaw
    at: Receiver
    ages: NetworkLaw | AgeChain
    states: DelayStates | None

    @property
    def of_packets(self) -> bool:
        """Whether it is a packet law with a chain of ages."""
        return isinstance(self.law, PacketAges) and isinstance(self.ages, AgeChain)

    def delays(self) -> DelayChain | None:
        """Return the delay chain of a packet law; None where the ages are no chain."""
        return delays_of(self.ages, self.at) if isinstance(self.ages, AgeChain) else None

    def neglects(self) -> str:
        """Return what the chain leaves out, in words; empty where it is exact."""
        chain = self.ages
        if not isinstance(chain, AgeChain) or not chain.neglected:
            return ""
        return (
            f"the latencies of {self.path} have no bound, and a packet is later than {chain.bound} slots with probability "
            f"{chain.neglected:.2g}, which is neglected; discard_older = {max(0, chain.bound - 1)} makes it exact"
        )

    def silent(self, slots: int = 0) -> float:
        """Return the probability that nothing has come in so many slots, nor while the chain distinguishes ages."""
        chain = self.ages
        if not isinstance(chain, AgeChain):
            return 0.0
        ages, weights = np.array(chain.mode_ages), chain.initial_law()
        last = max(chain.bound, self.at.max_age) + 1
        for k in range(max(last, slots)):  # nothing has come by slot k: of age k + 1 is what stands for it
            weights = np.where(ages >= min(k + 1, last), weights, 0.0) @ chain.transition_matrix()
        return float(weights[ages >= last].sum())


def received(path: str, law: NetworkLaw, at: Receiver, stays: int = 1) -> Received:
    """Return a network law as a receiver meets it.

    Args:
        path: of the law's table, for messages.
        law: the law, its files read.
        at: who receives.
        stays: lengths of stay at an age that the receiver distinguishes.
    """
    ages = ages_of(law, at)
    return Received(path=path, law=law, at=at, ages=ages, states=delay_states(ages, stays))
