"""What is proved of a haptic loop: passivity for every passive hand, stability in contact for the hand that is there.

Four questions, in this order. Is some contact unstable for the hand that is there? Then the loop is refused. Does the coupler
meet the condition for every delay? Is it one delay that stays? Is the wall passive, also where materials change, and does the
theory know all that the loop has? Where an answer is no, the verdict is undecided: the condition is sufficient, not necessary.

What a coupler needs for a delay that varies in any way from sample to sample, without waiting for the largest (`lags`):

Let a_j = u(j - d_j) be the force that is felt in slot j, and w_j the movement that the wall sees in slot k(j). Samples come in
their order, so that each movement is seen once, and k(j) - j - 1 is a whole number from the least to the largest tau: where tau
falls, several movements come at once. Coupler and wall see sum u(k(j)) w_j. If the coupler takes the squares below,

    sum u(k(j)) w_j <= -(1/4 beta) sum (u(k(j)) - a_j)^2,   then   sum a_j w_j <= beta sum w_j^2

by completing the square: what the motor gives, damping takes. Which pair (tau, d) it is in which slot is not known; the sum of
the squares of all pairs is an upper bound, and asks of the coupler

    (z - 1)/(T z) C(z) - sum_N (1 - z^-N)/(2 beta)   positive real,   N = tau + d + 1 over all pairs.

It is sufficient alone. Whether a coupler below it is safe under every change of delay is not decided: the exact question, over
all sequences of pairs, is one of a switched system over every passive hand. Waiting for the largest delay at both ends asks for
the largest N alone and is never softer: min of C(1) is N_max T/(2 beta) there and the sum of all N here.

Reference: Theorem 6.1 with random delays, 6.6; ERRATA 22; `design.passivity.condition`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import pairwise

import numpy as np

from design.controllers.rendered_wall import Coupler
from design.controllers.wall import Material, Wall
from design.passivity import HapticLoop, HeldDevice
from design.passivity.condition import damping_needed, is_passive_over
from design.passivity.synthesis import ceiling_n_per_m
from design.passivity.transparency import felt_n_per_m
from design.processes.delay_chain import DelayChain
from design.verdict import State, Verdict

METHOD = "passivity of the delayed coupler, decided exactly (in integers) at all frequencies; spectral radii of every contact"
QUANTITY = "damping that the coupler needs at its worst delay, N s/m"
ASSUMPTIONS = (
    "the hand is passive apart from its own bounded push, and is held rigidly",
    "the device damps at least as much as its model says",
    "the force is held over a sample and the wall takes backward differences",
)
ROUNDING = 1e-9
"""By what a radius of 1 may be missed: a hand without a spring rests at any depth behind an integrator."""


def certify_wall(
    *,
    device: HeldDevice,
    wall: Wall,
    coupler: Coupler,
    period_s: float,
    sc: DelayChain | int,
    ca: DelayChain | int,
    equalised: bool = False,
    saturates_n: float = math.inf,
) -> Verdict:
    """Say what is proved of a wall that is felt through a network.

    Args:
        device: device and the hand that the claim may count on: its damping is the least that any hand has.
        wall: materials and the rule for their change; by its chain, if it has one, the second moment of the loop in contact.
        coupler: C.
        period_s: T in s.
        sc, ca: delays of position and force: a chain, or a constant in samples.
        equalised: whether both ends wait until the largest delay has passed, so that the loop has that one delay.
        saturates_n: largest force of the motor in N.

    Returns:
        A verdict of kind ``passivity``, without a digest; every number is in its details.
    """
    beta = device.total_damping_n_s_per_m
    sides = [[d] if isinstance(d, int) else sorted({int(x) for x in d.delay}) for d in (sc, ca)]
    if equalised:
        sides = [side[-1:] for side in sides]
        sc, ca = sides[0][0], sides[1][0]
    delays = sorted({i + j for i in sides[0] for j in sides[1]})
    varies = any(len(side) > 1 for side in sides)
    asked = lags(*sides) if varies else delays
    loop = HapticLoop(device=device, coupler=coupler, period_s=period_s, sc_max=sides[0][-1], ca_max=sides[1][-1])
    details: dict[str, object] = {
        "delays": delays, "damping_n_s_per_m": beta, "static_compliance_m_per_n": coupler.static_compliance_m_per_n,
        "felt_n_per_m": [felt_n_per_m(m, coupler) for m in wall.touched],
        "ceiling_n_per_m": ceiling_n_per_m(period_s, beta, delays[-1]),
    }  # fmt: skip
    places = [(i, d) for i in range(len(wall.touched)) for d in delays]
    radii = [loop.radius(wall.touched[i], sc_at := min(d, sides[0][-1]), d - sc_at) for i, d in places]  # the sum alone matters
    where, radius = max(zip((f"{named(wall.touched[i])} at a delay of {d}" for i, d in places), radii), key=lambda item: item[1])
    details |= {"spectral_radius": radius, "spectral_radius_at": where, "stable": radius < 1.0 - ROUNDING}
    stays = [1.0 if wall.chain is None else wall.chain[i][i] for i in wall.met]  # probability, per slot; a hand may rest
    linear, moment = wall.switching == "plain" or wall.alike, 0.0  # else the energy rule moves the surface
    if wall.chain is not None:
        moment = loop.jump_system(wall.touched, np.array(wall.chain)[np.ix_(wall.met, wall.met)], sc, ca).radius()
        details |= {"mean_square_radius": moment, "stable": (moment if varies and linear else radius) < 1.0 - ROUNDING}
        if varies and not linear:  # of the paths alone on which a material stays
            alone = [loop.jump_system((m,), [[1.0]], sc, ca).radius() for m in wall.touched]
            moment = max(stay * each for stay, each in zip(stays, alone))
    if not varies and max(stays[i] * each**2 for each, (i, _) in zip(radii, places)) > 1.0 + ROUNDING:
        reason = f"the contact with {where} samples is not stable for the hand that is there (spectral radius {radius:.5g})"
        return _verdict("refused", reason, beta, radius, "spectral radius in contact", 1.0, details)
    if (varies or linear) and moment > 1.0 + ROUNDING:
        reason = f"in contact the second moment grows (radius {moment:.5g}) under the delays and materials of this loop"
        return _verdict("refused", reason, beta, moment, "second-moment radius in contact", 1.0, details)
    needed = damping_needed(coupler, period_s, asked, varying=varies)
    moves = varies and is_passive_over(coupler, period_s, beta, *asked) and keeps_order(sc)
    held = [is_passive_over(coupler, period_s, beta, d) for d in delays]
    holds = moves if varies else all(held)
    number = min(needed.damping_n_s_per_m, beta) if holds else needed.damping_n_s_per_m  # the exact answer decides
    details |= {"damping_needed_n_s_per_m": number, "worst_delay": needed.delay}
    spared = next(((i, m) for i, m in enumerate(wall.touched) if m.spared_m_per_n > m.most_spared_m_per_n(period_s)), None)
    if not all(held):
        failed = [d for d, met in zip(delays, held) if not met]
        why = (
            f"the coupler misses the condition at {_samples(failed)} of delay: it needs {number:.6g} N s/m, "
            f"device and hand have {beta:.6g} N s/m"
        )
    elif varies and not moves:
        why = (
            f"the delay varies over {_samples(delays)}; the condition is proved for each of them held, not for their change, "
            f"which takes {number:.6g} N s/m{'' if keeps_order(sc) else ' and samples that come in their order'}; "
            "coupler.equalise = true makes it one delay"
        )
    elif spared is not None:
        i, m = spared
        why = (
            f"wall.materials[{i}].spared_m_per_n: {m.spared_m_per_n:.6g} m/N; its own give makes up for 1/(K + 2 B/T) = "
            f"{m.most_spared_m_per_n(period_s):.6g} m/N of a coupler at most"
        )
    elif not wall.passive:
        what = "stiffness or coupler" if wall.spares else "stiffness"
        why = f'the wall gives energy away where its {what} changes under pressure; switching = "energy" makes it passive'
    else:
        why = cut_off(wall, coupler, saturates_n)
    passive = (
        f"passive for every passive hand and wall at {_samples(delays)} of delay{', in any order' if varies else ''}: needs "
        f"{number:.6g} N s/m, device and hand have {beta:.6g} N s/m"
    )
    return _verdict("undecided" if why else "certified", why or passive, beta, number, QUANTITY, beta, details)


def lags(sc: Iterable[int], ca: Iterable[int]) -> tuple[int, ...]:
    """Return the total delays whose F_N add up, each as often as a pair has it.

    Args:
        sc: delays tau of the position, in samples; they rise by at most one a slot.
        ca: delays d of the force, in samples, in any order.

    >>> lags([1, 2], [1])
    (2, 3)
    """
    taus, forces = sorted(set(sc)), sorted(set(ca))
    return tuple(sorted(tau + d for tau in range(taus[0], taus[-1] + 1) for d in forces))


def keeps_order(sc: DelayChain | int) -> bool:
    """Return whether no sample is seen after a newer one: the delay rises by at most one a slot.

    Args:
        sc: delay of the position.
    """
    if isinstance(sc, int):
        return True
    rise = sc.delay[None, :] - sc.delay[:, None]
    return bool((rise[np.asarray(sc.matrix) > 0.0] <= 1).all())


def cut_off(wall: Wall, coupler: Coupler, saturates_n: float) -> str:
    r"""Return why nothing is proved with a motor that saturates; empty where the proof holds.

    It is not cut off where the wall itself never asks for more. Else let g be what is cut off of f, and sat(f) >= 0 what is left.
    The device feels sat(f), and of a coupler with falling taps, h_0 = c_0, h_l = c_l - c_(l-1) <= 0,

        sum sat(f) (C f - C f(k-1)) >= sum sat(f) (C sat(f) - C sat(f)(k-1)),

    for sat(f) = F wherever g > 0, and F (h_0 + sum h_l) sum g >= 0. The wall behind sat is one with a spring that saturates.

    Args:
        wall: what is touched.
        coupler: C.
        saturates_n: F in N.
    """
    if wall.limit_n <= saturates_n:
        return ""
    taps = coupler.taps_m_per_n
    falls = all(a >= b for a, b in pairwise((*taps, 0.0))) and not coupler.integrator_m_per_n
    if falls and not wall.spares and len({m.stiffness_n_per_m for m in wall.touched}) == 1:
        return ""
    return (
        f"the motor saturates at {saturates_n:g} N, and the proof takes that for one stiffness behind taps that never rise; "
        f"wall.force_limit_n = {saturates_n:g} keeps the wall within it"
    )


def named(material: Material) -> str:
    """Return a material by its numbers K and B."""
    return f"a material of {material.stiffness_n_per_m:g} N/m and {material.damping_n_s_per_m:g} N s/m"


def _samples(delays: Sequence[int]) -> str:
    return f"{', '.join(map(str, delays))} sample{'s' if list(delays) != [1] else ''}"


def _verdict(
    state: State, reason: str, beta: float, number: float, quantity: str, limit: float, details: dict[str, object]
) -> Verdict:  # fmt: skip
    return Verdict(
        kind="passivity", state=state, reason=reason, number=number if math.isfinite(number) else None, quantity=quantity,
        limit=limit, method=METHOD, details=details,
        assumptions=(*ASSUMPTIONS, f"device and hand damp at least {beta:.6g} N s/m"),
    )  # fmt: skip
