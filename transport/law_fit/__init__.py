"""Which network law explains a record of packets: which class, which parameters, how sure, or none of these.

Latencies come first, ages second: independent latencies give dependent ages, so that a fit of ages calls every network Markov.
A packet law (independent latencies, with independent loss or a channel of two modes) is kept unless its residuals say that
latencies or losses depend on what was before, and so do the slots in which packets come, which is all that a loop sees. Only then
ages are fitted, as a Markov or a semi-Markov chain, the better by BIC; and only if its residuals are independent is it the law.
Of packets that depend on each other, and come more often than slots, the first of every slot is fitted.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from transport.errors import FieldError
from transport.law_fit.age_models import AgeFit, fit_ages
from transport.law_fit.latency_families import LatencyFit, bic, fit_latencies
from transport.law_fit.loss_models import LossFit, fit_loss
from transport.law_fit.packet_record import JITTER, PacketRecord, ages_of, delays_in_slots, one_per_slot
from transport.law_fit.proportions import LAGS, REJECT, Fitness, fitness
from transport.laws.packet import OLDEST

LawClass = Literal["constant", "independent", "gilbert-elliott", "markov", "semi-markov", "none"]

STREAM = (0x72657369, 0x6475616C)
"""Of the uniform numbers in randomised residuals: the same record has the same verdict, and no run draws from this stream."""

NO_PARAMETERS = 0


class Candidate(Struct, frozen=True, kw_only=True):
    """One law that was tried: what it was fitted to, BIC (comparable among what was fitted to the same), and its tests."""

    name: str
    fitted_to: Literal["latencies", "losses", "ages"]
    parameters: int
    bic: float
    fitness: Fitness | None = None


class LawFit(Struct, frozen=True, kw_only=True, eq=False):
    """What a record says of its network law.

    Attributes:
        law_class: which class of law, "none" where none of them explains the record.
        spec: the law as an experiment writes it, with its `kind`; of "none" the least wrong one, for a look.
        latencies, losses: fits of latencies and of losses, taken as independent.
        ages: the fit of ages, where latencies are not independent.
        candidates: all that was tried, the best of every kind first.
        tested: residuals of the packet law: independence of latencies and losses, and the shape.
        in_slots: p-value of independence of the slots in which packets come, where that of latencies is rejected; else 1.
        record: what was fitted.
        period_s, deadline_s: length of a slot, and when it closes.
    """

    law_class: LawClass
    spec: dict[str, Any]
    latencies: LatencyFit
    losses: LossFit
    ages: AgeFit | None
    candidates: tuple[Candidate, ...]
    tested: Fitness
    in_slots: float
    record: PacketRecord
    period_s: float
    deadline_s: float


def fit_law(record: PacketRecord, period_s: float | None = None, deadline_s: float | None = None) -> LawFit:
    """Fit a network law.

    Args:
        record: packets.
        period_s: length of a slot; by default the time between two packets.
        deadline_s: when a slot closes; by default after 0.6 of it, as in an experiment.

    Raises:
        FieldError: a period or deadline that is none, latencies of more slots than a law covers, or packets that depend on each
            other, sent further apart than slots.
    """
    period = record.period_s if period_s is None else period_s
    deadline = 0.6 * period if deadline_s is None else deadline_s
    if not 0.0 < period < np.inf or not 0.0 <= deadline < np.inf:
        raise FieldError("period", f"got {period:g} s with a deadline of {deadline:g} s, expected a positive period")
    came, until = record.came, record.censored_s
    longest = float(record.latency_s[came].max())
    if longest > OLDEST * period:
        said = f"up to {longest:g} s, and slots of {period:g} s: a law covers {OLDEST} slots"
        raise FieldError("latency_s", f"{said}; clocks that differ need both directions")
    overtaken = ~came & np.isfinite(until)
    latencies = fit_latencies(record.latency_s[came], until[overtaken])
    losses = fit_loss(~came & ~overtaken, whole=not overtaken.any())
    checks = {id(f): _tested(record, f, losses[0]) for f in latencies}
    chosen = next((f for f in latencies if checks[id(f)].shaped), next((f for f in latencies if f.name == "table"), latencies[0]))
    tested = checks[id(chosen)]
    in_slots = 1.0 if tested.independent else _slots_independent(record, period, deadline)
    independent = tested.independent or in_slots > REJECT
    if not independent or losses[0].kind == "gilbert-elliott":  # then how far apart packets are counts
        if record.period_s > JITTER * period:
            said = f"they depend on each other, sent {record.period_s:.4g} s apart; expected one in every slot of {period:.4g} s"
            raise FieldError("packets", f"{said}: hil probe --rate {1.0 / period:.4g}, or a sensor's clock of one slot")
        slotted = one_per_slot(record, period)
        if slotted is not record:
            return fit_law(slotted, period, deadline)
    n, ordered = len(came), sorted(latencies, key=lambda f: f is not chosen)
    tried = [_candidate(f.name, "latencies", f, n, checks[id(f)]) for f in ordered]
    tried += [_candidate(f"loss: {f.kind}", "losses", f, n) for f in losses]
    packet = {"kind": "packet", "latency": chosen.spec} | ({"loss": losses[0].spec()} if losses[0].kind != "none" else {})
    found = LawFit(
        law_class="none", spec=_readable(packet | _bounded(record, chosen, period, deadline)), latencies=chosen,
        losses=losses[0], ages=None, candidates=tuple(tried), tested=tested, in_slots=in_slots, record=record, period_s=period,
        deadline_s=deadline,
    )  # fmt: skip
    if independent:
        if losses[0].kind == "gilbert-elliott":
            return replace(found, law_class="gilbert-elliott")
        alone = chosen.name == "constant" and losses[0].kind == "none"
        return replace(found, law_class="constant" if alone else "independent")
    chains = fit_ages(ages_of(record, period, deadline))
    if not chains:
        return found
    checked = [fitness(f.low, f.high, NO_PARAMETERS, _own_numbers()) for f in chains]
    tried += [
        Candidate(name=f.kind, fitted_to="ages", parameters=f.parameters, bic=f.score, fitness=t) for f, t in zip(chains, checked)
    ]
    best = chains[0]
    sound = checked[0].independent
    kind: LawClass = "none" if not sound else "markov" if best.kind == "markov" else "semi-markov"
    return replace(found, law_class=kind, spec=_readable(best.spec), ages=best, candidates=tuple(tried))


def _readable(value: Any) -> Any:
    """The same with numbers of 12 digits at most, as a person would write them: 0.717 and not 0.7170000000000001."""
    if isinstance(value, float):
        return float(f"{value:.12g}")
    if isinstance(value, dict):
        return {key: _readable(each) for key, each in value.items()}
    return [_readable(each) for each in value] if isinstance(value, list) else value


def _own_numbers() -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(0, spawn_key=STREAM))


def _candidate(
    name: str, to: Literal["latencies", "losses"], fit: LatencyFit | LossFit, n: int, tested: Fitness | None = None
) -> Candidate:
    score = bic(fit.log_likelihood, fit.parameters, n)
    return Candidate(name=name, fitted_to=to, parameters=fit.parameters, bic=score, fitness=tested)


def _tested(record: PacketRecord, latencies: LatencyFit, losses: LossFit) -> Fitness:
    """Residuals of a packet law. A packet that is lost comes after all that are not: Pr(X <= x) = (1 - loss) F(x)."""
    kept = 1.0 - losses.predicted
    came, until = record.came, record.censored_s
    low, high = np.empty(len(came)), np.ones(len(came))
    low[came] = kept[came] * latencies.below(record.latency_s[came])
    high[came] = kept[came] * latencies.cdf(record.latency_s[came])
    low[~came] = kept[~came] * latencies.cdf(until[~came])
    return fitness(low, np.maximum(high, low), latencies.parameters + losses.parameters, _own_numbers())


def _bounded(record: PacketRecord, latencies: LatencyFit, period_s: float, deadline_s: float) -> dict[str, int]:
    """What bounds a latency without a bound: the receiver discards what is later than anything that was measured."""
    longest = int(delays_in_slots(record, period_s, deadline_s).max())
    return {} if latencies.name in ("constant", "table", "uniform") else {"discard_older": longest}


def _slots_independent(record: PacketRecord, period_s: float, deadline_s: float) -> float:
    """p-value of independence of the slots up to `LAGS` apart: Fisher's exact test of each delay that comes up and of loss."""
    if np.isfinite(record.censored_s).any():
        return 0.0  # what was overtaken has no slot
    delays = delays_in_slots(record, period_s, deadline_s)
    found = np.unique(delays)
    if len(found) == 1:
        return 1.0
    from scipy import stats  # half a second of CPU

    smallest = 1.0
    for delay in found.tolist():
        here = delays == delay
        for lag in range(1, LAGS + 1):
            pairs = np.array([[(a & b).sum() for b in (here[lag:], ~here[lag:])] for a in (here[:-lag], ~here[:-lag])])
            smallest = min(smallest, float(stats.fisher_exact(pairs).pvalue))
    return min(1.0, smallest * len(found) * LAGS)
