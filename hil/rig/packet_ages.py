"""What a receiver makes of a packet law: the chain of the ages that it measures, and what it does beyond the largest it knows.

Beyond `max_age` the controller keeps the newest sample, and takes the gains of the largest delay; the actuator has no row, and
holds the input that it applied before.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hil.experiment import Experiment
from hil.rig.sensor_list import sensors_of
from transport.laws.delay_states import DelayStates, delay_states
from transport.laws.protocols import AgeChain, NetworkLaw, PacketAges

if TYPE_CHECKING:
    from design.processes.delay_chain import DelayChain


class Receiver(NamedTuple):
    """Who receives: when slots close (s), the largest age that it has rows or gains for, and whether it holds an input."""

    period_s: float
    deadline_s: float
    max_age: int
    holds_input: bool


def controller_of(e: Experiment) -> Receiver:
    """Return how the controller of an experiment receives."""
    return Receiver(float(e.period), e.timing.deadline * float(e.period), e.links.sc.max_age, holds_input=False)


def actuator_of(e: Experiment) -> Receiver:
    """Return how the actuator of an experiment receives."""
    return Receiver(float(e.period), e.timing.deadline * float(e.period), e.links.ca.max_age, holds_input=True)


def ages_of(law: NetworkLaw, at: Receiver) -> NetworkLaw | AgeChain:
    """Return the chain of the ages at a receiver under a packet law that has one, any other law as it is."""
    found = law.age_chain(at.period_s, at.deadline_s, at.max_age) if isinstance(law, PacketAges) else law
    return law if isinstance(found, str) else found


def states_at(law: NetworkLaw, at: Receiver) -> DelayStates | None:
    """Return the chain of the measured age, see `transport.laws.delay_states`."""
    return delay_states(ages_of(law, at))


def packet_delays(law: NetworkLaw, at: Receiver) -> DelayChain | None:
    """Return the delay chain under a packet law at a receiver; None where the ages are no chain, or the law is another one."""
    chain = ages_of(law, at)
    if not isinstance(chain, AgeChain):
        return None
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


def neglects(e: Experiment) -> str:
    """Return what the chains of an experiment leave out, in words; empty where they are exact."""
    for name, law, at in (
        *((f"nodes.{s.name}" if e.nodes else "links.sc", s.law, controller_of(e)) for s in sensors_of(e)),
        ("links.ca", e.links.ca.law, actuator_of(e)),
    ):
        chain = ages_of(law, at)
        if isinstance(chain, AgeChain) and chain.neglected:
            return (
                f"the latencies of {name}.law have no bound, and a packet is later than {chain.bound} slots with probability "
                f"{chain.neglected:.2g}, which is neglected; discard_older = {max(0, chain.bound - 1)} makes it exact"
            )
    return ""


def unheard(e: Experiment, slots: int = 0) -> float:
    """Return the probability that the controller has heard nothing in so many slots, nor while the chain tells ages apart.

    Args:
        e: checked, its laws loaded, with one sensor node.
        slots: in which nothing moves.
    """
    chain = ages_of(sensors_of(e)[0].law, controller_of(e))
    if not isinstance(chain, AgeChain):
        return 0.0
    ages, weights = np.array(chain.mode_ages), chain.initial_law()
    last = max(chain.bound, e.links.sc.max_age) + 1
    for k in range(max(last, slots)):  # nothing has come by slot k: of age k + 1 is what stands for it
        weights = np.where(ages >= min(k + 1, last), weights, 0.0) @ chain.transition_matrix()
    return float(weights[ages >= last].sum())
