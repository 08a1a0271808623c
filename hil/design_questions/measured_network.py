"""A network as it was measured: the chains that are designed for, and the certificate over all that remains possible.

The second moment is monotone in every transition probability: a radius below 1 at the upper bounds of all of them certifies every
chain in the region, also one that changes from slot to slot.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from design.processes.delay_chain import DelayChain
from design.verdict import Verdict
from hil.design_questions import TrackingTarget, digest_of_design, linear_verdict, on_plant
from hil.errors import HilError
from hil.experiment import parse_table
from hil.rig.delay_chains import chain_of
from hil.rig.receiver import Receiver, received
from transport.errors import NotKnown
from transport.law_fit.proportions import AgeRegion, arrivals, behind_late, confidence_region, seen_correlations
from transport.laws import ChainLaw, NetworkLaw, PacketAges, SemiMarkovLaw

if TYPE_CHECKING:
    from design.tracking.synthesis import Design
    from transport.law_fit import LawFit

OLDEST_DISTINGUISHED = 3
"""Ages that gains tell apart, at most, where a measured latency may last longer."""
MOST_TIMES = 1e6


class Measured(Struct, frozen=True, kw_only=True):
    """One direction: what was fitted, the law, and who receives."""

    fit: LawFit
    law: NetworkLaw
    at: Receiver

    @property
    def assumed(self) -> str:
        """What a region of the chain rests on, and no interval covers."""
        if self.fit.law_class == "markov":
            return f"no age is above {self.at.max_age}, the largest in the record"
        fit = self.fit
        if fit.tested.independent:
            seen = seen_correlations(len(fit.record.sent_s)).neighbours
            said = f"which the record does not reject; a correlation of neighbours below {seen:.2g} is often missed"
        else:
            said = "in slots, which the record does not reject; it does reject that latencies do"
        low, high = behind_late(fit)
        behind = f"behind a late or lost one the next is, too, in {100.0 * low:.2g} to {100.0 * high:.2g} % (95 %)"
        way, oldest = "network.ca" if self.at.holds_input else "network.sc", len(arrivals(fit).came) - 1
        late = f"{oldest} slot{'s' * (oldest != 1)} late"
        discarded = f"none that comes more than {late}, as none in the record does, is taken"
        return f"packets of {way} come independently of each other, {said}; {behind}; {discarded}"

    def chain(self) -> DelayChain:
        """Return the chain of the fitted law.

        Raises:
            HilError: it has none.
        """
        found = chain_of(received("law", self.law, self.at))
        if found is None:
            raise HilError(f"the law {self.fit.law_class!r} has no finite chain of ages")
        return found

    def region(self, factor: float) -> DelayChain:
        """Return the chain with the bounds of its confidence region; see `confidence_region`."""
        return _chain_of(confidence_region(self.fit, self.at.max_age, factor, share=0.5), self.at)  # together 95 %


def measured(fit: LawFit, *, holds_input: bool) -> Measured:
    """Return a fitted direction as its receiver sees it.

    Raises:
        HilError: no class of law explains the record.
    """
    if fit.law_class == "none":
        raise HilError("none of the laws explains the record: there is nothing to design for; measure for longer")
    law: NetworkLaw = parse_table("hil.laws", fit.spec, "law")
    at = Receiver(fit.period_s, fit.deadline_s, 0, holds_input)
    if isinstance(law, PacketAges):
        try:
            chain = law.age_chain(fit.period_s, fit.deadline_s)
        except NotKnown as why:
            raise HilError(str(why)) from None
        return Measured(fit=fit, law=law, at=at._replace(max_age=min(OLDEST_DISTINGUISHED, chain.bound)))
    if not isinstance(law, ChainLaw | SemiMarkovLaw):
        raise HilError(f"the law {law.kind!r} states no ages")
    return Measured(fit=fit, law=law, at=at._replace(max_age=max(law.mode_ages)))


def over_network(target: TrackingTarget, sc: Measured, ca: Measured) -> TrackingTarget:
    """Return what is designed for, over measured laws."""
    return target._replace(sc=sc.chain(), ca=ca.chain(), left_out="", reached=None)


def region_verdict(target: TrackingTarget, design: Design, sc: Measured, ca: Measured) -> Verdict:
    """Return the verdict over the whole confidence region, with the packets that would do where these do not.

    Args:
        target: from `over_network`.
        design: what was designed for it.
        sc, ca: both directions.
    """
    try:
        verdict = _verdict(target, design, sc, ca, 1.0)
    except NotKnown as why:
        return Verdict(kind="mean-square stability", state="undecided", reason=f"no confidence region: {why}",
                       method="upper bounds of every transition", digest=digest_of_design(target, design))  # fmt: skip
    packets = min(len(sc.fit.record.sent_s), len(ca.fit.record.sent_s))
    if verdict.state == "certified":
        said = f"mean-square stable for every chain of ages that {packets} packets leave possible, with 95 % confidence"
        reason = f"{said} (second-moment radius at most {verdict.details['tail_radius']:.5g})"
        assumed = dict.fromkeys((sc.assumed, ca.assumed))
        return on_plant(target, replace(verdict, reason=reason, assumptions=(*verdict.assumptions, *assumed)))
    enough = _enough(target, design, sc, ca, packets)
    least = "more packets would not decide it" if enough is None else f"about {enough} packets in the same shares would do"
    return replace(
        verdict,
        state="undecided",
        reason=f"{packets} packets are too few to certify every chain that they leave possible: {least}",
    )


def _verdict(target: TrackingTarget, design: Design, sc: Measured, ca: Measured, factor: float) -> Verdict:
    return linear_verdict(target, design, sc.region(factor), ca.region(factor))


def _enough(target: TrackingTarget, design: Design, sc: Measured, ca: Measured, packets: int) -> int | None:
    """Return how many packets certify the region, to 10 %, in two digits; None where not even a million times as many do."""

    def holds(factor: float) -> bool:
        return _verdict(target, design, sc, ca, factor).state == "certified"

    low, high = 1.0, 2.0
    while not holds(high):
        low, high = high, 4.0 * high
        if high > MOST_TIMES:
            return None
    while high > 1.1 * low:
        middle = (low * high) ** 0.5
        low, high = (low, middle) if holds(middle) else (middle, high)
    return int(float(f"{packets * high:.2g}"))


def _chain_of(region: AgeRegion, at: Receiver) -> DelayChain:
    ages = np.array(region.ages)
    if not region.open_ended:
        return DelayChain(transition=region.matrix, delays=ages, between=(region.low, region.high))
    oldest = at.max_age if at.holds_input else max(at.max_age, region.bound)
    return DelayChain(
        transition=region.matrix, delays=np.minimum(ages, oldest), labels=np.minimum(ages, at.max_age), held=ages > oldest,
        between=(region.low, region.high),
    )  # fmt: skip
