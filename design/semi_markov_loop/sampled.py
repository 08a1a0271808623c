"""Is the semi-Markov jump loop that a rig runs mean-square stable: sampled, held, delayed, its modes seen at the samples?

    dx/dt = A_i x + B_i u,    u(t) = K(r, h) x((k - tau) T) computed in slot k, held over [(k + d) T, (k + d + 1) T)

The mode i jumps at any instant; the controller sees it (Chapter 2), or a detected mode r with a clock of its own (Chapter 4), at
the samples only, and counts the sojourn h from its first sight in whole periods. Six proofs:

- one process: ``sojourn_renewal``, the second moments from one seen change to the next, between two sides; certifies and refuses;
  where the sides are far apart, ``sojourn_cells`` has ages in parts of a period;
- an uncertain plant: the same upper side, then ``sampled_phase``, a Lyapunov function over age and phase; it certifies, and a
  constant plant within the bounds that is not stable refuses;
- failure and detection: ``sampled_detection``, a Lyapunov function on pairs of modes and sections, checked by eigenvalues;
- random delays: ``sampled_random_delay``, the modes of the plant times those of the network; certifies and refuses;
- a loop too large for either: ``sampled_detection`` has a quadratic form that grows while the mode stays; refuses only;
- a state delay inside the plant: ``sampled_inner_delay``, a Lyapunov function over the phase of a period, for every delay within
  its bounds; it certifies. One of them is 0: where the loop without a delay grows, that refuses.

What neither decides is undecided, with the reason, and so is what ``_not_covered`` lists.

References: thesis (2.16)-(2.17), (4.1)-(4.3), sampled.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import replace

import msgspec
import numpy as np

from design.controllers.scheduled_gain import ScheduledGain
from design.errors import FieldError, check_above_zero
from design.lmi.program import LmiSolution
from design.processes.delay_chain import DelayChain
from design.processes.semi_markov import FaultDetection, SemiMarkov
from design.semi_markov_loop import DelayedJumpSystem, JumpSystem, NormBounded, balanced
from design.semi_markov_loop.period_moments import TooLarge
from design.semi_markov_loop.sampled_detection import DetectionLoop, growth_while_it_stays, lyapunov_decrease, slowest_growth
from design.semi_markov_loop.sampled_inner_delay import delayed_decrease
from design.semi_markov_loop.sampled_phase import uncertain_decrease
from design.semi_markov_loop.sampled_random_delay import random_delay_verdict
from design.semi_markov_loop.sojourn_cells import refined
from design.semi_markov_loop.sojourn_renewal import SampledLoop, renewal_radius
from design.verdict import State, Verdict

TOLERANCE = 1e-6
"""How far from the limit a number must lie to decide: rounding and quadrature stay below it."""
MARGIN = 1e-6
"""The least fall of V in a period that counts, for P up to 1e5 I: rounding and quadrature stay below it."""
_SLACKS = (2.0, 1.0, 4.0, 0.5, 8.0, 0.25)
LONG = "in the long run "
_ASSUMED = ("the rates are as given, within their own bounds", "the periods are exact and no sample or packet is lost")


def sampled_verdict(
    system: JumpSystem | DelayedJumpSystem,
    process: SemiMarkov | FaultDetection,
    gain: ScheduledGain,
    *,
    period_s: float,
    tau: int | DelayChain = 0,
    d: int | DelayChain = 0,
    least_delay_s: float = 0.0,
) -> Verdict:
    """Return whether the sampled loop is mean-square stable; the digest is left empty.

    Args:
        system: matrices; an uncertainty may vary freely in time (only upper bounds then certify).
        process: rates of the mode, or failure and detection (the gain then sees r, or nothing).
        gain: K(mode, h); h is (count of samples in the mode + tau) T.
        period_s: T (s).
        tau: age of the samples at the controller, in periods.
        d: age of the packets at the actuator, in periods.
        least_delay_s: smallest delay inside the plant (s); above 0 the loop without it decides nothing.

    Raises:
        ValueError: shapes that do not fit, a period or delay out of range.
    """
    check_above_zero(period_s=period_s)
    late = _constant(tau=tau, d=d)
    if isinstance(system, DelayedJumpSystem) and not (system.ad.any() and system.delay_max_s):
        system = JumpSystem(a=system.a + system.ad, b=system.b)
    if why := _not_covered(system, process, gain, random=late is None):
        return _undecided(why)
    system.check(process, gain)
    system, gain = balanced(system, gain, period_s)
    try:
        if isinstance(system, DelayedJumpSystem):
            if isinstance(process, SemiMarkov) and late is not None:
                return _delayed(system, process, gain, period_s, *late, least_delay_s)
            beside = "random delays of the network" if late is None else "a detected mode"
            return _undecided(f"a delay inside the plant together with {beside} is not decided")
        if late is None:
            return random_delay_verdict(system, process, gain, period_s, *(_chain(delay) for delay in (tau, d)))
        if isinstance(process, FaultDetection):
            return _detection(system, process, gain, period_s, *late)
        return _renewal(system, process, gain, period_s, *late)
    except TooLarge as error:
        if isinstance(system, DelayedJumpSystem) or system.uncertainty is not None or late is None:
            return _undecided(str(error))
        return _growing(system, process, gain, period_s, *late) or _undecided(str(error))


def _not_covered(
    system: JumpSystem | DelayedJumpSystem, process: SemiMarkov | FaultDetection, gain: ScheduledGain, *, random: bool
) -> str:
    """Why no proof here covers such a loop, over random delays of the network or none; empty where one does."""
    plain, detected = isinstance(system, JumpSystem), isinstance(process, FaultDetection)
    uncertain, faulty = ((False, False) if isinstance(system, DelayedJumpSystem) else
                         (system.uncertainty is not None, system.sensors is not None))  # fmt: skip
    linear, by_age = gain.schedule != "hold", not np.array_equal(gain.gain, np.broadcast_to(gain.gain[:, :1], gain.gain.shape))
    processes = [process.failure, *process.detection] if isinstance(process, FaultDetection) else [process]
    endless = [
        mode for one in processes for mode in range(one.modes)
        if not np.isfinite(one.bounds(mode, 0.0, math.inf)[1]).all()
    ]  # fmt: skip
    reasons = (
        (random and uncertain, "uncertain matrices together with random delays of the network are not decided"),
        (random and faulty, "sensors that fail together with random delays of the network are not decided"),
        (random and by_age, "a gain that depends on the sojourn time is not decided over random delays"),
        (not random and detected and uncertain, "an uncertainty beside a detected mode is not decided"),
        (not random and detected and "eta" in gain.measured,
         f"the gain depends on {' and '.join(gain.measured)}; a controller sees the detected mode only"),
        (not random and linear and detected, "a gain that is linear in the sojourn time is not decided beside a detected mode"),
        (not random and linear and not plain,
         "a gain that is linear in the sojourn time is not decided beside a delay inside the plant"),
        (not detected and faulty, "sensors that fail in a mode that is seen belong into the gains"),
        (bool(endless), f"the rates out of mode {endless[0] + 1 if endless else 0} have no finite bound"),
    )  # fmt: skip
    return next((why for holds, why in reasons if holds), "")


def _constant(**delays: int | DelayChain) -> tuple[int, int] | None:
    """Both delays in periods; None where one of them is random."""
    found: list[int] = []
    for name, delay in delays.items():
        values = np.unique(delay.delay if isinstance(delay, DelayChain) else delay)
        if values[0] < 0:
            raise FieldError(name, f"{delay} periods, expected none or more")
        found += [int(values[0])] * (values.size == 1)
    return (found[0], found[1]) if len(found) == 2 else None


def _chain(delay: int | DelayChain) -> DelayChain:
    return delay if isinstance(delay, DelayChain) else DelayChain(transition=[[1.0]], delays=[delay])


def _undecided(reason: str) -> Verdict:
    return Verdict(kind="mean-square stability", state="undecided", reason=reason, method="sampled jump loop")


def _renewal(system: JumpSystem, process: SemiMarkov, gain: ScheduledGain, period_s: float, tau: int, d: int) -> Verdict:
    modes = list(range(system.modes))
    loop = SampledLoop(system=system, process=process, gain=gain, period_s=period_s, tau=tau, d=d)
    assumed: tuple[str, ...] = _ASSUMED
    if system.uncertainty is not None:
        assumed = (*_ASSUMED, "the uncertainty is within its bounds and may vary freely in time")
    if system.uncertainty is None:
        upper = renewal_radius(loop, modes, upper=True)
    else:
        upper = math.inf
        for slack in _slacks(system):
            upper = min(upper, renewal_radius(loop, modes, upper=True, slack=slack))
            if upper < 1.0 - TOLERANCE:
                break
    if upper < 1.0 - TOLERANCE:
        return _decided("certified", "", f"at most {upper:.6g}", upper, assumed, modes)
    lower, which = 0.0, ""
    for name, plant in _constant_plants(system):
        own = renewal_radius(replace(loop, system=plant), modes, upper=False)
        if own > lower:
            lower, which = own, name
        if lower > 1.0 + TOLERANCE:
            return _decided("refused", which, f"at least {lower:.6g}", lower, assumed, modes)
    both = f"at least {lower:.6g}, and by at most {upper:.6g}"
    if system.uncertainty is not None:
        why = f"{LONG}second moments{which} are multiplied by {both}"
        return _uncertain(loop, f"{why} from one seen change of the mode to the next", assumed)
    try:
        finer = refined(loop, modes)
    except np.linalg.LinAlgError:  # moments of too many sizes
        finer = None
    if finer is not None:
        factor = f"at {'most' if finer.state == 'certified' else 'least'} {finer.growth:.6g}"
        return Verdict(
            kind="mean-square stability", state=finer.state, number=finer.growth, limit=1.0, assumptions=assumed,
            quantity="growth of the second moments per period", details={"modes": [mode + 1 for mode in modes]},
            reason=f"{LONG}second moments are multiplied by {factor} a period (ages in {finer.parts} parts of it)",
            method="sampled jump loop: ages in parts of a period, between proved sides",
        )  # fmt: skip
    return _decided("undecided", which, both, upper, assumed, modes)


def _searched(search: Callable[[], LmiSolution], period_s: float) -> tuple[bool, float | None, str]:
    """Whether a Lyapunov function was found, the largest eigenvalue of its change per second, and what is known, in words."""
    try:
        found = search()
        return found.margin * period_s > MARGIN and found.slack >= 0.0, -found.margin, found.explain()
    except TooLarge as error:
        return False, None, str(error)


def _uncertain(loop: SampledLoop, bracket: str, assumed: tuple[str, ...]) -> Verdict:
    """The verdict on an uncertain plant that the bounds of its second moments leave open."""
    proved, number, said = _searched(lambda: uncertain_decrease(loop), loop.period_s)
    return Verdict(
        kind="mean-square stability", state="certified" if proved else "undecided", number=number, limit=0.0,
        reason=f"{'a' if proved else 'no'} Lyapunov function falls within every period and at every sample, however the "
        f"uncertainty varies: {said}" + ("" if proved else f"; {bracket}"),
        quantity="largest eigenvalue of the change of V per second", assumptions=assumed,
        method="sampled jump loop, uncertain: Lyapunov function over age and phase of a period",
    )  # fmt: skip


def _constant_plants(system: JumpSystem) -> Iterable[tuple[str, JumpSystem]]:
    """Plants that the uncertainty lets be, each for ever, with what to call them: one that is not stable refutes."""
    yield "" if system.uncertainty is None else " of the nominal loop", replace(system, uncertainty=None)
    for vertex in system.vertices:
        if vertex is not None:
            yield f" of the loop at vertex {vertex + 1} of the uncertainty", system.at_vertex(vertex)


def _slacks(system: JumpSystem) -> list[float]:
    uncertainty = system.uncertainty
    if isinstance(uncertainty, NormBounded):
        size = float(np.linalg.norm(uncertainty.e, 2, axis=(1, 2)).max() * np.linalg.norm(uncertainty.fa, 2, axis=(1, 2)).max())
    else:
        size = 0.0 if uncertainty is None else float(np.linalg.norm(uncertainty.da, 2, axis=(2, 3)).max())
    return [factor * max(size, 1e-6) for factor in _SLACKS]


def _decided(state: State, which: str, factor: str, number: float, assumed: tuple[str, ...], modes: Iterable[int]) -> Verdict:
    moments = f"second moments{which}"
    what = f"{moments} have no finite mean at the end of a stay in a mode: they grow faster than it is left"
    if math.isfinite(number):
        what = f"{LONG}{moments} are multiplied by {factor} from one seen change of the mode to the next"
    return Verdict(
        kind="mean-square stability", state=state, reason=what, number=number,
        quantity="spectral radius of the second moments per seen sojourn", limit=1.0, assumptions=assumed,
        method="sampled jump loop: sojourns between proved sides", details={"modes": [mode + 1 for mode in modes]},
    )  # fmt: skip


def _growing(
    system: JumpSystem,
    process: SemiMarkov | FaultDetection,
    gain: ScheduledGain,
    period_s: float,
    tau: int,
    d: int,
) -> Verdict | None:
    """The refusal of a loop that is too large for its second moments, where it is unstable while a mode stays; None elsewhere."""
    real = process.failure if isinstance(process, FaultDetection) else process
    loop = SampledLoop(system=system, process=real, gain=gain, period_s=period_s, tau=tau, d=d)
    growth = 0.0
    for mode in range(system.modes):
        # a seen mode stays with its last gain; of a fault nothing is seen, and any gain of any detected mode may act
        held = gain.gain.reshape(-1, *gain.gain.shape[2:]) if isinstance(process, FaultDetection) else gain.gain[mode, -1:]
        held = held @ system.shown(mode)
        growth = max(growth, growth_while_it_stays(loop, mode, list(held), float(real.bounds(mode, 0.0, math.inf)[1].sum())))
    if growth <= 1.0 + TOLERANCE:
        return None
    return Verdict(
        kind="mean-square stability", state="refused", number=growth, limit=1.0, assumptions=_ASSUMED,
        quantity="lower bound of the growth of the second moments per period",
        reason=f"{LONG}second moments are multiplied by at least {growth:.6g} per period, by the paths on which the mode stays",
        method="sampled jump loop: a quadratic form that grows while the mode stays",
    )  # fmt: skip


def _delayed(
    system: DelayedJumpSystem, process: SemiMarkov, gain: ScheduledGain, period_s: float, tau: int, d: int, least_s: float
) -> Verdict:
    undelayed = JumpSystem(a=system.a, b=system.b)
    loop = SampledLoop(system=undelayed, process=process, gain=gain, period_s=period_s, tau=tau, d=d)
    proved, number, said = _searched(lambda: delayed_decrease(system, loop), period_s)
    if not proved and least_s > 0.0:
        said += f"; that it is stable without a delay is not asked, as the plant has {least_s:g} s at least"
    elif not proved:
        without = sampled_verdict(replace(system, delay_max_s=0.0), process, gain, period_s=period_s, tau=tau, d=d)
        if without.state == "refused":
            said = f"with a delay of 0 inside the plant, which its bounds allow, {without.reason}"
            return msgspec.structs.replace(without, reason=said)
    return Verdict(
        kind="mean-square stability", state="certified" if proved else "undecided", number=number, limit=0.0,
        reason=f"{'a' if proved else 'no'} Lyapunov function falls within every period and at every sample: {said}",
        quantity="largest eigenvalue of the change of V per second and at a sample",
        method="sampled jump loop with a delay inside: Lyapunov function over the phase of a period",
        assumptions=(*_ASSUMED, "in every mode the delay is a function of time that grows at most by its slope"),
    )  # fmt: skip


def _detection(system: JumpSystem, process: FaultDetection, gain: ScheduledGain, period_s: float, tau: int, d: int) -> Verdict:
    loop = DetectionLoop.of(system, process, gain, period_s=period_s, tau=tau, d=d)
    found = lyapunov_decrease(loop)
    method = "sampled jump loop: Lyapunov function on failure, detection and section"
    if found.holds and found.margin * period_s > MARGIN:
        return Verdict(
            kind="mean-square stability", state="certified", number=-found.margin, limit=0.0, method=method,
            quantity="largest eigenvalue of the change of V per second, P >= I", assumptions=_ASSUMED,
            reason=f"a Lyapunov function falls over every period: {found.explain()}",
        )  # fmt: skip
    growth = slowest_growth(loop)
    state: State = "refused" if growth > 1.0 + TOLERANCE else "undecided"
    reason = f"{LONG}second moments are multiplied by at least {growth:.6g} per period"
    return Verdict(
        kind="mean-square stability", state=state, number=growth, limit=1.0, method=method, assumptions=_ASSUMED,
        quantity="lower bound of the spectral radius of the second moments per period",
        reason=reason if state == "refused" else f"{reason}; {found.explain()}",
    )  # fmt: skip
